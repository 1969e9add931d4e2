#version 460
// Lowers the certainty of V where another V explains the photographs better. A workgroup takes two by two blocks. CPU
// reference: src/engine/stages/ambiguity.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a kernel without a mean.
layout(constant_id = 3) const bool WARPED = false;
layout(constant_id = 4) const bool MASKED = false;

#include "blur.glsl"
#include "noise.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;   // of I1, then of I2
// Half as wide and high: means of C, b², (∇²V)², b Σb and of the squared residual.
layout(binding = 2, r32f) uniform image2DArray terms;
layout(binding = 3, std430) readonly buffer StateBuffer { State state; };
layout(binding = 4, std430) readonly buffer Mask { uint mask[]; };     // a byte per pixel: 0 where there are no results
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int second_stack;                // its first layer
    float centre[2];
    float mean[2];                   // of the kernel at variance 1
    float limit;                     // largest |V|, px²
    float eta;                       // of the data term
    float pixels;                    // pixels of a window
    Noise noise;                     // of the full-size image
};

#include "pair.glsl"

// Side of a block, px; distance of its samples; samples along its side.
const int BLOCK = 32, STEP = 4, SAMPLES = 8;
// The other V: six on either side of 0.
const int OTHERS = 12;
// The least number of samples for another V.
const float LEAST = 12.0;
// Another V is better below this share of the energy.
const float BETTER = 0.9;
// The curvature may be that of noise below this multiple of that of noise alone. Another V is no worse there below this
// share of the energy.
const float BY_NOISE = 3.0, NO_WORSE = 1.05;
// Among other V whose energies differ by less than rounding, the first one counts.
const float LESS = 0.9999;
const int B2 = 1, SQUARE = 4;        // layers of the terms
const int BLOCKS = 4;                // of a workgroup

// By sample: the energies at V and at the other V, and whether both are known.
shared vec3 energies[BLOCKS][SAMPLES * SAMPLES];
// The other V of least energy, and its share of the energy at V; NO_WORSE if all are worse.
shared vec2 best[BLOCKS];

// The squared residual at a V, over what noise adds to it there; -1 where the blur reaches beyond an image.
float energy(ivec2 x, float v) {
    Registration r = state.registration;
    vec2 d = displacement_of(r, state.parallax, vec2(x), v, 1.0, vec2(centre[0], centre[1]));
    Variances of = variances_at(v, state.separation);
    if (!inside(x, d, ivec2(width, height), of, scale_of(r))) return -1.0;
    float s = residual_of(sample_pair(x, d, of, 1.0));
    return s * s / (blurred_power(noise, of.first, 1.0).value + blurred_power(noise, of.second, 1.0).value);
}

// The noise of an image that is blurred by `variance`, and the first and second derivatives of it by V.
vec3 noise_by_v(float variance, float by_v) {
    Power power = blurred_power(noise, variance, 1.0);
    float along = noise.fall + 2.0 * noise.reach * variance, cube = power.value * power.value * power.value;
    float bend = (0.75 * along * along * power.value * power.value - noise.reach) * cube;
    return vec3(power.value, power.slope * by_v, bend * by_v * by_v);
}

// What noise alone adds to the curvature at V, if the residuals are noise.
float curvature_of_noise(float v, float square) {
    Variances of = variances_at(v, state.separation);
    vec3 n = noise_by_v(of.first, of.first_by_v) + noise_by_v(of.second, of.second_by_v);
    return 0.25 * (n.z - n.y * n.y / n.x) * square / (n.x * sqrt(eta * eta + 1.57 * square));
}

void main() {
    int invocation = int(gl_LocalInvocationIndex), block = invocation / (SAMPLES * SAMPLES);
    int sample_of = invocation % (SAMPLES * SAMPLES);
    ivec2 corner = 2 * BLOCK * ivec2(gl_WorkGroupID.xy);
    ivec2 x = corner + BLOCK * ivec2(block % 2, block / 2) + STEP * ivec2(sample_of % SAMPLES, sample_of / SAMPLES);
    float own = -1.0, near = 0.0;
    if (x.x < width && x.y < height) {
        near = imageLoad(terms, ivec3(x / 2, SQUARE)).r;
        int pixel = x.y * width + x.x;
        bool counts = near > 0.0;
        if (MASKED) counts = counts && (mask[pixel / 4] >> 8 * (pixel & 3) & 0xffu) != 0u;
        if (counts) own = energy(x, imageLoad(relative_blur, ivec3(x, 0)).r);
    }
    if (sample_of == 0) best[block] = vec2(0.0, NO_WORSE);
    for (int n = 0; n < OTHERS; n++) {
        float share = float(n / 2 + 1) / float(OTHERS / 2), size = limit * share * share;
        float other = n % 2 == 0 ? size : -size, there = own < 0.0 ? -1.0 : energy(x, other);
        barrier();
        energies[block][sample_of] = there < 0.0 ? vec3(0.0) : vec3(own / near, there / near, 1.0);
        barrier();
        if (sample_of == 0) {
            vec3 sum = vec3(0.0);
            for (int i = 0; i < SAMPLES * SAMPLES; i++) sum += energies[block][i];
            if (sum.z >= LEAST && sum.y < LESS * best[block].y * sum.x) best[block] = vec2(other, sum.y / sum.x);
        }
    }
    barrier();
    // Sixteen by sixteen invocations take every second pixel of each block in turn.
    for (block = 0; block < BLOCKS; block++) {
        ivec2 place = 2 * ivec2(invocation % (BLOCK / 2), invocation / (BLOCK / 2));
        x = corner + BLOCK * ivec2(block % 2, block / 2) + place;
        if (x.x >= width || x.y >= height || !(best[block].y < NO_WORSE)) continue;
        float v = imageLoad(relative_blur, ivec3(x, 0)).r, curvature = imageLoad(terms, ivec3(x / 2, 0)).r;
        // The curvature at which σ_V is the distance.
        float reaching = sqrt(imageLoad(terms, ivec3(x / 2, B2)).r / pixels) / max(abs(v - best[block].x), 1e-9);
        if (curvature <= reaching) continue;
        if (curvature < BY_NOISE * curvature_of_noise(v, imageLoad(terms, ivec3(x / 2, SQUARE)).r)) {
            curvature = 0.0;
        } else if (best[block].y < BETTER) {
            curvature = reaching;
        }
        imageStore(terms, ivec3(x / 2, 0), vec4(curvature));
    }
}
