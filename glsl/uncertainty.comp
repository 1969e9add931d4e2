#version 460
// V where it is valid and NaN elsewhere, its standard deviation, and the residual. CPU reference:
// src/engine/stages/uncertainty.rs.

#include "nan.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 4) const bool MASKED = false;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32f) uniform readonly image2DArray terms;  // on every other pixel, means: C, b², (∇²V)², b Σb, S²
layout(binding = 2, r32f) uniform writeonly image2DArray result;       // layers: V, its standard deviation, residual
layout(binding = 3, std430) readonly buffer StateBuffer { State state; };
layout(binding = 4, std430) readonly buffer Mask { uint mask[]; };     // a byte per pixel: 0 where there are no results
layout(push_constant) uniform Constants {
    int width, height;
    float centre[2];
    float pixels;                    // pixels of a window
    float bending;                   // weight of (∇²V)² relative to the data's variance
    float largest;                   // standard deviation, px²
    float at_limit;                  // |V| from which V is only a bound, px²
    float widest;                    // variance that the blur stacks reach, px²
    float eta;                       // of the data term
    float features;                  // independent samples of what is not noise in a window
};

// Residuals beyond this many deviations of the noise are no noise.
const float NOISE = 3.0;
// The noise is at least η over this, as for the step of T.
const float BROAD = 4.0;
// Beyond this many they show something else, and V is not measured where it is less certain than this, px².
const float UNEXPLAINED = 10.0, CERTAIN = 1.0;

#include "terms.glsl"

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy), size = ivec2(width, height);
    if (x.x >= width || x.y >= height) return;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r;
    Registration r = state.registration;
    Variances of = variances_at(v, state.separation);
    bool valid = inside(x, displacement_of(r, state.parallax, vec2(x), v, 1.0, vec2(centre[0], centre[1])), size, of, scale_of(r));
    uint pixel = x.y * width + x.x;
    if (MASKED) valid = valid && (mask[pixel / 4] >> 8 * (pixel & 3) & 0xffu) != 0u;
    vec4 mean = vec4(term(0, x, size), term(1, x, size), term(2, x, size), term(4, x, size));
    float data = mean.y / (pixels * mean.x * mean.x);
    // The mean squared slope of S follows from b² = S² slope²/ψ².
    float spread = max(state.spread, eta / BROAD), noise = NOISE * spread, beyond = max(mean.w - noise * noise, 0.0);
    float unexplained = beyond * mean.w / (mean.y * (mean.w + eta * eta));
    bool measured = mean.x > 0.0 && abs(v) < at_limit && max(of.first, of.second) < widest;
    float deviation = measured ? min(sqrt(data + bending * mean.z + unexplained / features), largest) : largest;
    float other = UNEXPLAINED * spread;
    if (mean.w > other * other && deviation > CERTAIN) deviation = largest;
    const float NONE = uintBitsToFloat(0x7fc00000u);
    imageStore(result, ivec3(x, 0), vec4(valid ? v : NONE));
    imageStore(result, ivec3(x, 1), vec4(valid ? deviation : NONE));
    imageStore(result, ivec3(x, 2), vec4(valid ? state.unit * sqrt(max(mean.w, 0.0)) : NONE));
}
