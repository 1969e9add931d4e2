#version 460
// One channel of the fused image, equation 37: the sharper of I1 and J at each pixel. CPU reference:
// src/engine/stages/fuse.rs.

#include "spline.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray channel1;
layout(binding = 1, r32f) uniform readonly image2DArray spline2;       // coefficients of the channel of I2
layout(binding = 2, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 3, r32f) uniform writeonly image2DArray result;
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    float centre[2];
};

#include "fuse.glsl"

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r, first = variances_at(v, 0.0).first_by_v;
    vec2 photographs = photographs_at(x, v);
    imageStore(result, ivec3(x, layer), vec4(mix(photographs.y, photographs.x, first)));
}
