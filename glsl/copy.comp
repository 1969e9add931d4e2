#version 460
// Copies an image, to measure the memory bandwidth. CPU reference: src/engine/stages/copy.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray from;
layout(binding = 1, r32f) uniform writeonly image2DArray to;
layout(push_constant) uniform Constants { int width, height, layer; };

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    imageStore(to, ivec3(x, layer), vec4(imageLoad(from, ivec3(x, 0)).r));
}
