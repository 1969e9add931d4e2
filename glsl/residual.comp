#version 460
// The squared residual that neither blur nor T explains, on every other pixel: H S1² + (1 - H) S2². CPU reference:
// src/engine/stages/residual.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a Gaussian.
layout(constant_id = 3) const bool WARPED = false;

#include "blur.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 2, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of I2
layout(binding = 3, r32f) uniform writeonly image2DArray terms;      // half as wide and high
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    int nodes;
    int second_stack;                // its first layer
    float centre[2];
    float mean[2];                   // of the kernel at V = 1
    float epsilon;
};

#include "pair.glsl"

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy), x = 2 * h, size = ivec2(width, height);
    if (x.x >= width || x.y >= height) return;
    Registration r = state.registration;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r, square = 0.0;
    vec2 d = displacement(r, x, 1.0, vec2(centre[0], centre[1]));
    if (inside(x, d, size, v, scale_of(r))) {
        PairSample both = sample_pair(x, d, v);
        float s1 = both.b1.value - (r.gain * both.j.value + r.offset);
        float s2 = r.gain * both.b2.value + r.offset - both.i1;
        square = mix(s2 * s2, s1 * s1, clamp(0.5 + atan(v / epsilon) / 3.14159265358979, 0.0, 1.0));
    }
    imageStore(terms, ivec3(h, layer), vec4(square));
}
