#version 460
// Estimates the kernel's shape in windows of the photographs, one workgroup each. CPU reference:
// src/engine/stages/shape_windows.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;

#include "blur.glsl"
#include "mask.glsl"
#include "noise.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of the warped I2; of a Gaussian
layout(binding = 2, std430) readonly buffer StateBuffer { State state; };
layout(binding = 3, r32f) uniform readonly image2DArray masks;          // of I1, of I2
layout(binding = 4, std430) writeonly buffer Partials { float partials[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int second_stack;                // its first layer
    int grid[2];                     // columns and rows of windows
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    Noise noise;
};

#include "coefficients.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

const int SIDE = 24;                 // of a window, pixels
const float COUNTED = 0.99;          // rounding of the averaged mask: 2e-5
// The terms of S: the window's own V, t_x, t_y, offset and gain; the kernel's shape; and S itself.
const int TERMS_OF_S = 7;
const int SHAPE = 5, LEFT = 6;
const int PAIRS = TERMS_OF_S * (TERMS_OF_S + 1) / 2;
// Sums of |V|, of the pixels, of those with V ≥ 0, and of the power of I2's noise on I1's pixels.
const int VARIANCE = PAIRS, COUNT = PAIRS + 1, FIRST = PAIRS + 2, BETWEEN = PAIRS + 3;
// Sum of the magnitudes of the mixed differences of S, |S(x, y) - S(x + 1, y) - S(x, y + 1) + S(x + 1, y + 1)| / 2.
const int MIXED = PAIRS + 4, SUMMED = PAIRS + 5;
shared float residuals[SIDE * SIDE];
shared float by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][SUMMED];

// The departure of a disk from a Gaussian at |V|, between two nodes.
float departure_at(int image, float v, vec2 shift, ivec3 columns_at, ivec3 lines) {
    int k = node_below(v, nodes);
    float v0 = node_variance(k), v1 = node_variance(k + 1), departures[2];
    for (int n = 0; n < 2; n++) {
        int at = k + n, from = departs_from(at, nodes);
        if (at == 0) { departures[n] = 0.0; continue; }
        vec3 variances, values;
        for (int m = 0; m < 3; m++) {
            variances[m] = node_variance(from + m);
            values[m] = spline_near(stencil(image, from + m, columns_at, lines), shift).value;
        }
        departures[n] = departure(node_variance(at), variances, values);
    }
    return mix(departures[0], departures[1], min((v - v0) / (v1 - v0), 1.0));
}

// The terms at a pixel: derivatives of S, and S.
void terms_at(ivec2 x, float v, float around, out float terms[TERMS_OF_S]) {
    Registration r = state.registration;
    ivec2 size = ivec2(width, height);
    ivec3 columns_at = ivec3(reflect_once(ivec2(x.x - 1, x.x), size.xx), reflect_once(ivec2(x.x + 1), size.xx).x);
    ivec3 lines = ivec3(reflect_once(ivec2(x.y - 1, x.y), size.yy), reflect_once(ivec2(x.y + 1), size.yy).x);
    vec2 shift = displacement(moved_since(state.warped, r), x, factor, vec2(centre[0], centre[1]));
    Blur blur = Blur(size, nodes, vec2(0.0));
    PairSample both = blur_near(blur, v, shift, stencil(1, 0, columns_at, lines), stencil(2, 0, columns_at, lines), columns_at, lines);
    bool first = v >= 0.0;
    float departs = departure_at(first ? 1 : 2, abs(v), first ? vec2(0.0) : shift, columns_at, lines);
    // Terms of the sharper image, blurred by V: noise of the other is in S, and must not be in the terms.
    Blurred sharper = first ? both.b1 : both.b2;
    float s = first ? sharper.value - (r.gain * both.j.value + r.offset) : both.i1 - (r.gain * sharper.value + r.offset);
    departs *= first ? 1.0 : -r.gain;
    terms = float[](sharper.slope, sharper.gradient.x, sharper.gradient.y, 1.0, sharper.value - around, departs,
                    s + state.kernel_shape * departs);
}

// Eliminates the window's V, t, offset and gain, and fits the rest of S by the rest of the departure: shape beyond the
// current one, and the inverse of its variance.
vec2 estimate(float sums[SUMMED]) {
    float m[TERMS_OF_S][TERMS_OF_S], whole[TERMS_OF_S];
    for (int i = 0, n = 0; i < TERMS_OF_S; i++) {
        for (int j = i; j < TERMS_OF_S; j++, n++) m[i][j] = sums[n];
        whole[i] = m[i][i];
    }
    for (int p = 0; p < SHAPE; p++) {
        // A term that depends on the others is left with rounding errors.
        if (!(m[p][p] > 1e-5 * whole[p])) continue;
        for (int i = p + 1; i < TERMS_OF_S; i++) {
            for (int j = i; j < TERMS_OF_S; j++) m[i][j] -= m[p][i] * m[p][j] / m[p][p];
        }
    }
    float information = m[SHAPE][SHAPE];
    // A window that is not complete, or whose shape depends on the other terms.
    if (sums[COUNT] < float(SIDE * SIDE) || !(information > 1e-4 * whole[SHAPE]) || !(information > 1e-9)) return vec2(0.0);
    float left = max(m[LEFT][LEFT] - m[SHAPE][LEFT] * m[SHAPE][LEFT] / information, 0.0) / float(SIDE * SIDE - TERMS_OF_S);
    // Noise of the sharper image is in both S and the departure. That of I2 is interpolated, and has the gain. The
    // other image's noise is not blurred in S, so that mixed differences measure it. Errors of the fit are smooth and
    // hardly contribute.
    float pixels = float(SIDE * SIDE), v = max(sums[VARIANCE] / pixels, 0.1), q = 16.0 / 9.0;
    float first = sums[FIRST] / pixels, between = sums[BETWEEN] / pixels, square = state.registration.gain * state.registration.gain;
    float before = mix(between, 1.0, first), own = mix(square, 1.0, first), other = mix(1.0, square * between, first);
    vec3 variances = vec3(v / q, v, v * q), powers;
    for (int n = 0; n < 3; n++) powers[n] = own * blurred_power(noise, 0.5 * (v + variances[n]), before).value;
    // Of a normal distribution the mean magnitude is √(2/π) deviations.
    float mixed = sums[MIXED] / float((SIDE - 1) * (SIDE - 1)), noise_power = 1.5707963 * mixed * mixed / other;
    float shared_noise = pixels * noise_power * departure(v, variances, powers);
    // 5e-4: at least that of rounding to 256 values.
    return vec2(-(m[SHAPE][LEFT] - shared_noise) / information, information / (left + 2.5e-7));
}

void main() {
    ivec2 size = ivec2(width, height), windows = ivec2(grid[0], grid[1]), window = ivec2(gl_WorkGroupID.xy);
    ivec2 corner = (2 * window + 1) * size / (2 * windows) - SIDE / 2;
    Registration r = state.registration;
    float scale = scale_of(r), around = unit_of_coefficients() * coefficient(2, ivec3(corner + SIDE / 2, 0)), sums[SUMMED];
    for (int i = 0; i < SUMMED; i++) sums[i] = 0.0;
    int step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int n = int(gl_LocalInvocationIndex); n < SIDE * SIDE; n += step) {
        residuals[n] = 0.0;
        ivec2 x = corner + ivec2(n % SIDE, n / SIDE);
        float v = imageLoad(relative_blur, ivec3(x, 0)).r;
        vec2 d = displacement(r, x, factor, vec2(centre[0], centre[1]));
        if (!inside(x, d, size, v, scale) || counts(x, d, size) < COUNTED) continue;
        float terms[TERMS_OF_S];
        terms_at(x, v, around, terms);
        residuals[n] = terms[LEFT];
        for (int i = 0, at = 0; i < TERMS_OF_S; i++) {
            for (int j = i; j < TERMS_OF_S; j++, at++) sums[at] += terms[i] * terms[j];
        }
        sums[VARIANCE] += abs(v);
        sums[COUNT] += 1.0;
        sums[FIRST] += v >= 0.0 ? 1.0 : 0.0;
        sums[BETWEEN] += interpolated_power(d);
    }
    barrier();
    for (int n = int(gl_LocalInvocationIndex); n < (SIDE - 1) * (SIDE - 1); n += step) {
        int at = n / (SIDE - 1) * SIDE + n % (SIDE - 1);
        float mixed = residuals[at] - residuals[at + 1] - residuals[at + SIDE] + residuals[at + SIDE + 1];
        sums[MIXED] += 0.5 * abs(mixed);
    }
    for (int i = 0; i < SUMMED; i++) {
        float sum = subgroupAdd(sums[i]);
        if (subgroupElect()) by_subgroup[gl_SubgroupID][i] = sum;
    }
    barrier();
    if (gl_LocalInvocationIndex != 0) return;
    for (int i = 0; i < SUMMED; i++) {
        sums[i] = 0.0;
        for (uint group = 0; group < gl_NumSubgroups; group++) sums[i] += by_subgroup[group][i];
    }
    vec2 result = estimate(sums);
    int n = window.y * grid[0] + window.x;
    partials[2 * n] = result.x;
    partials[2 * n + 1] = result.y;
}
