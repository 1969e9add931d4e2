#version 460
// V of a level from V of the next coarser one: read at x/2, times four. CPU reference: src/engine/stages/prolong.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray coarse;
layout(binding = 1, r32f) uniform writeonly image2DArray fine;
layout(push_constant) uniform Constants {
    int width, height;                   // of the fine level
    float limit;                         // of |V|, px² of the fine level
    float gain;                          // 4 for V: a px² of the coarse level is four of the fine one
};

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    ivec2 last = ivec2(width - 1, height - 1) / 2;
    ivec2 low = x / 2, high = min((x + 1) / 2, last);
    float sum = imageLoad(coarse, ivec3(low, 0)).r + imageLoad(coarse, ivec3(high.x, low.y, 0)).r
              + imageLoad(coarse, ivec3(low.x, high.y, 0)).r + imageLoad(coarse, ivec3(high, 0)).r;
    imageStore(fine, ivec3(x, 0), vec4(clamp(0.25 * gain * sum, -limit, limit)));
}
