#version 460
// The standard deviation of the scale of V, by the law, the correlation of neighbouring residuals, and parallax.
// One workgroup. CPU reference: src/engine/stages/scale_deviation.rs.

#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32f) uniform readonly image2DArray terms;   // on every other pixel: means of C, b², (∇²V)², b Σb
layout(binding = 2, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;               // of the terms
    float at_limit;                  // |V| from which V is only a bound, px²
    uint is_disk;                    // a disk is stated
};

// Samples along x and y.
const int SIDE = 64;
// σ of the scale if a disk blurs by the relative law, and if all residuals are correlated with their neighbours.
const float OF_LAW = 0.06, OF_RESIDUALS = 0.2;
// The variance of a window's ratio by chance.
const float CHANCE = 1.75;
shared vec2 sums[gl_WorkGroupSize.x * gl_WorkGroupSize.y];   // of ratios, samples

void main() {
    int first = int(gl_LocalInvocationIndex), step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    vec2 sum = vec2(0.0);
    for (int n = first; n < SIDE * SIDE; n += step) {
        ivec2 h = ivec2(n % SIDE * width, n / SIDE * height) / SIDE;
        float b2 = imageLoad(terms, ivec3(h, 1)).r;
        bool counts = b2 > 0.0 && abs(imageLoad(relative_blur, ivec3(2 * h, 0)).r) < at_limit;
        if (counts) sum += vec2(imageLoad(terms, ivec3(h, 3)).r / b2, 1.0);
    }
    sums[first] = sum;
    barrier();
    if (first != 0) return;
    for (int n = 1; n < step; n++) sum += sums[n];
    float excess = max(sum.x / max(sum.y, 1.0) - 1.0, 0.0), share = excess / (1.0 + excess);
    bool is_relative = is_disk != 0u || state.kernel_shape != 0.0 && state.separation == 0.0;
    state.scale_deviation = length(vec3(is_relative ? OF_LAW : 0.0, OF_RESIDUALS * share, state.parallax_size));
    state.correlated = excess * excess / (excess * excess + CHANCE);
}
