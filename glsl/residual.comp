#version 460
// The squared residual S² that neither blur nor T explains, on every other pixel. CPU reference:
// src/engine/stages/residual.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a kernel without a mean.
layout(constant_id = 3) const bool WARPED = false;

#include "blur.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of I2
layout(binding = 2, r32f) uniform writeonly image2DArray terms;      // half as wide and high
layout(binding = 3, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    int nodes;
    int second_stack;                // its first layer
    float centre[2];
    float mean[2];                   // of the kernel at variance 1
};

#include "pair.glsl"

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy), x = 2 * h, size = ivec2(width, height);
    if (x.x >= width || x.y >= height) return;
    Registration r = state.registration;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r, square = 0.0;
    vec2 d = displacement_of(r, state.parallax, vec2(x), v, 1.0, vec2(centre[0], centre[1]));
    Variances of = variances_at(v, state.separation);
    if (inside(x, d, size, of, scale_of(r))) {
        float s = residual_of(sample_pair(x, d, of, 1.0));
        square = s * s;
    }
    imageStore(terms, ivec3(h, layer), vec4(square));
}
