#version 460
// Applies the shading to I2, without gain and offset. CPU reference: src/engine/stages/apply_shading.rs.

#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray from;           // I2
layout(binding = 1, r32f) uniform writeonly image2DArray to;
layout(binding = 2, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    float centre[2];
};

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    if (x == ivec2(0)) state.applied_shading = state.shading;
    vec2 centre = vec2(centre[0], centre[1]);
    float shading = shading_at(state.shading, (vec2(x) - centre) / centre);
    imageStore(to, ivec3(x, layer), vec4(shading * imageLoad(from, ivec3(x, 0)).r));
}
