#version 460
// V ← V + share clamp(dV). CPU reference: src/engine/stages/update.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray red;
layout(binding = 1, r32f) uniform readonly image2DArray black;
layout(binding = 2, r32f) uniform image2DArray relative_blur;
layout(push_constant) uniform Constants {
    int width, height;
    float largest_step, limit;           // px² of the level
    float share;                         // of dV that is added
};

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    ivec3 h = ivec3(x.x / 2, x.y, 0);
    float change = (x.x + x.y & 1) == 0 ? imageLoad(red, h).r : imageLoad(black, h).r;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r + share * clamp(change, -largest_step, largest_step);
    imageStore(relative_blur, ivec3(x, 0), vec4(clamp(v, -limit, limit)));
}
