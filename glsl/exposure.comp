#version 460
// Estimates gain, offset and shading from samples of the blur-matched pair. One workgroup. CPU reference:
// src/engine/stages/exposure.rs.

#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

layout(local_size_x = 64, local_size_y = 8, local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool SHADES = false;               // also matches the shading
layout(binding = 0, std430) readonly buffer Samples { float means[]; };   // of I1, I2 times the share; of the share
layout(binding = 1, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;               // of the level
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    int every;                       // pixels of the pair from sample to sample
    int adopt;                       // 1: gain and offset; 0: measure the correlation only
    float dependent;                 // samples that are worth one independent sample
};

// A sample of both images, its share, its weight, and its place on I2, -1 to 1 along either side.
struct Sample {
    float u, v;
    float share;
    float weight;                    // one over its expected squared residual, 1 in the dark
    vec2 place;
};

const float DARK = 0.01;

int columns() { return (width + 2 * every - 1) / (2 * every); }
int samples() { return columns() * ((height + 2 * every - 1) / (2 * every)); }

Sample sample_at(int n, Registration r) {
    const Sample NONE = Sample(0.0, 0.0, 0.0, 0.0, vec2(0.0));
    if (n >= samples()) return NONE;
    ivec2 x = 2 * every * ivec2(n % columns(), n / columns());
    float share = means[2 * samples() + n];
    if (!(share > 0.5)) return NONE;
    vec2 centre = vec2(centre[0], centre[1]);
    vec2 place = (vec2(x) + displacement(r, x, factor, centre) - centre) / centre;
    float u = means[n] / share, v = means[samples() + n] / share;
    float middle = 0.5 * (u + v);
    return Sample(u, v, share, DARK * DARK / (DARK * DARK + middle * middle), place);
}

const int MOMENTS = 3;
shared float by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][MOMENTS];
shared float added[MOMENTS];

// Written by invocation 0, read by all: barrier() orders shared memory, but not writes to the state.
shared float correlation, gain, offset;
shared float shading[TERMS];

// Sums over the samples, with weights: of 1, I1, I2 less `centre` if not `square`, else of I1², I2², I1 I2.
vec3 moments(Registration r, vec2 centre, bool square) {
    vec3 own = vec3(0.0);
    int step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int n = int(gl_LocalInvocationIndex); n < samples(); n += step) {
        Sample p = sample_at(n, r);
        float u = p.u - centre.x, v = p.v - centre.y;
        own += p.share * p.weight * (square ? vec3(u * u, v * v, u * v) : vec3(1.0, u, v));
    }
    vec3 sum = subgroupAdd(own);
    if (subgroupElect()) {
        for (int i = 0; i < MOMENTS; i++) by_subgroup[gl_SubgroupID][i] = sum[i];
    }
    barrier();
    if (gl_LocalInvocationIndex < MOMENTS) {
        float all = 0.0;
        for (uint group = 0; group < gl_NumSubgroups; group++) all += by_subgroup[group][gl_LocalInvocationIndex];
        added[gl_LocalInvocationIndex] = all;
    }
    barrier();
    return vec3(added[0], added[1], added[2]);
}

// Gain and offset from mean and deviation of both images.
void match_moments(Registration r) {
    vec3 first = moments(r, vec2(0.0), false);
    float count = max(first.x, 1e-12);
    vec2 mean = first.yz / count;
    vec3 second = moments(r, mean, true) / count;
    if (gl_LocalInvocationIndex == 0) {
        vec2 variance = second.xy;
        // 1e-6: a deviation of 0.001, below which the images hardly have contrast.
        bool contrast = min(variance.x, variance.y) > 1e-6;
        correlation = contrast ? second.z / (sqrt(variance.x) * sqrt(variance.y)) : 0.0;
        state.correlation = correlation;
        // Images that hardly correlate, for example because they are far apart, do not determine the gain.
        if (adopt == 1) {
            gain = correlation > 0.5 ? sqrt(variance.x / variance.y) : 1.0;
            offset = mean.x - gain * mean.y;
            state.registration.gain = gain;
            state.registration.offset = offset;
        }
    }
    barrier();
}

// I1 minus the offset is a polynomial of the place times I2, of DEGREE. The sums are those of its normal equations: each
// product of two Legendre polynomials is a sum of such polynomials of up to twice the degree, with positive factors. So
// there is a sum for each of these polynomials, and one for each term of the right side; then the shares that count, the
// squares that the previous polynomial leaves, and those that its constant term alone leaves, both times the weight.
// One sum for each element of the normal equations would be 136, too many for registers.
const int DEGREE = 4, TWICE = 2 * DEGREE;
const int ALL = TERMS + 1;
const int RIGHT = (TWICE + 1) * (TWICE + 2) / 2;
const int COUNT = RIGHT + ALL, LEFT = COUNT + 1, BEFORE = COUNT + 2, FITTED = COUNT + 3;
const int ROUNDS = 3;
// Sums whose subgroups' shares are in shared memory at a time.
const int BATCH = 16;
shared float fitted[FITTED];
shared float shares[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][BATCH];
shared float rows[ALL][ALL + 1];    // with the right side as last column
shared float diagonals[ALL];
shared float coefficients[ALL];
shared float scale;                  // of residuals, from which on a sample is an outlier

// The Legendre polynomials of degree 0 to TWICE.
void legendre_to_twice(float x, out float p[TWICE + 1]) {
    p[0] = 1.0;
    p[1] = x;
    [[unroll]] for (int n = 1; n < TWICE; n++)
        p[n + 1] = (float(2 * n + 1) * x * p[n] - float(n) * p[n - 1]) * (1.0 / float(n + 1));
}

// The index of a term by its degrees along x and y.
int term_of(int x, int y) { return (x + y) * (x + y + 1) / 2 + y; }

// All sums over all samples, or those of the squares alone: an invocation adds up its own in registers, then subgroups
// theirs, then these in order. One sum per invocation, over samples in shared memory, took 20 times as long.
void add_up(Registration r, float constant, bool first, const bool all) {
    float sums[FITTED];
    [[unroll]] for (int n = 0; n < FITTED; n++) sums[n] = 0.0;
    float applied[TERMS] = state.applied_shading, before[TERMS] = shading;
    int step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int n = int(gl_LocalInvocationIndex); n < samples(); n += step) {
        Sample p = sample_at(n, r);
        // I2 without its shading.
        float second = p.v / shading_at(applied, p.place), target = p.u - offset;
        float left = target - constant * second * shading_at(before, p.place), alone = target - constant * second;
        float counts = first ? p.share : p.share / (1.0 + p.weight * left * left / (scale * scale));
        float weight = counts * p.weight;
        sums[COUNT] += counts;
        sums[LEFT] += weight * left * left;
        sums[BEFORE] += weight * alone * alone;
        if (!all) continue;
        float px[TWICE + 1], py[TWICE + 1];
        legendre_to_twice(p.place.x, px);
        legendre_to_twice(p.place.y, py);
        // Loops of constant length, which compilers unroll, so that the sums are in registers.
        [[unroll]] for (int i = 0; i <= TWICE; i++) {
            float by_x = weight * second * px[i];
            [[unroll]] for (int j = 0; j <= TWICE; j++) {
                if (i + j <= TWICE) sums[term_of(i, j)] += by_x * second * py[j];
                if (i + j <= DEGREE) sums[RIGHT + term_of(i, j)] += by_x * target * py[j];
            }
        }
    }
    [[unroll]] for (int batch = all ? 0 : COUNT; batch < FITTED; batch += BATCH) {
        [[unroll]] for (int k = 0; k < BATCH; k++) {
            if (batch + k >= FITTED) continue;
            float sum = subgroupAdd(sums[batch + k]);
            if (subgroupElect()) shares[gl_SubgroupID][k] = sum;
        }
        barrier();
        uint lanes = subgroupAdd(1u), lane = subgroupExclusiveAdd(1u);
        for (uint first = 0; first < BATCH; first += gl_NumSubgroups) {
            uint k = first + gl_SubgroupID;
            bool counts = k < BATCH && batch + k < FITTED;
            float own = 0.0;
            if (counts)
                for (uint group = lane; group < gl_NumSubgroups; group += lanes) own += shares[group][k];
            float sum = subgroupAdd(own);
            if (counts && subgroupElect()) fitted[batch + k] = sum;
        }
        barrier();
    }
}

// The factor of P_(p+q-2r) in P_p P_q (Adams).
float factor_of(int p, int q, int r) {
    // (2n - 1)!!/n!
    const float A[TWICE + 1] = float[](1.0, 1.0, 1.5, 2.5, 4.375, 7.875, 14.4375, 26.8125, 50.2734375);
    int sum = p + q - r;
    return A[r] * A[p - r] * A[q - r] / A[sum] * float(2 * (sum - r) + 1) / float(2 * sum + 1);
}

// An element of the normal equations, of two terms by their degrees.
float normal(ivec2 p, ivec2 q) {
    float sum = 0.0;
    for (int i = 0; i <= min(p.x, q.x); i++) {
        float by_x = factor_of(p.x, q.x, i);
        for (int j = 0; j <= min(p.y, q.y); j++)
            sum += by_x * factor_of(p.y, q.y, j) * fitted[term_of(p.x + q.x - 2 * i, p.y + q.y - 2 * j)];
    }
    return sum;
}

// Gauss and Jordan's elimination, an element for each invocation: the matrix is positive definite. 1e-5 of the diagonal
// keeps terms that the samples hardly determine from growing. One invocation alone would wait for shared memory some
// 900 times in a row.
void solve() {
    int index = int(gl_LocalInvocationIndex), i = index / (ALL + 1), j = index % (ALL + 1);
    bool mine = i < ALL;
    float own = 0.0;
    if (mine) {
        own = j == ALL ? fitted[RIGHT + i] : normal(degrees(i), degrees(j));
        if (i == j) diagonals[i] = own = own * (1.0 + 1e-5) + 1e-12;
        rows[i][j] = own;
    }
    barrier();
    for (int k = 0; k < ALL; k++) {
        float over = 1.0 / max(rows[k][k], 1e-6 * diagonals[k]);
        if (mine && i != k) own -= rows[i][k] * over * rows[k][j];
        barrier();
        if (mine && j > k) rows[i][j] = own;
        barrier();
    }
    if (mine && j == ALL) coefficients[i] = own / max(rows[i][i], 1e-6 * diagonals[i]);
    barrier();
}

void match_shading(Registration r) {
    int n = int(gl_LocalInvocationIndex);
    if (n == 0) coefficients[0] = gain;
    if (n < TERMS) shading[n] = state.shading[n];
    barrier();
    for (int round = 0; round < ROUNDS; round++) {
        add_up(r, coefficients[0], round == 0, true);
        solve();
        if (n < TERMS) shading[n] = coefficients[n + 1] / max(coefficients[0], 1e-3);
        // Twice the deviation of the residuals in the dark; in the first round those of the previous polynomial.
        if (n == 0) scale = 2.0 * sqrt(fitted[LEFT] / max(fitted[COUNT], 1.0)) + 1e-6;
        barrier();
    }
    add_up(r, coefficients[0], false, false);
    if (n >= TERMS) return;
    // James and Stein: subtracts what chance explains with as many terms and independent samples.
    float chance = fitted[LEFT] * float(TERMS) * dependent / max(fitted[COUNT], 1.0), explained = fitted[BEFORE] - fitted[LEFT];
    float significant = explained > chance ? 1.0 - chance / explained : 0.0;
    state.shading[n] = significant * shading[n];
}

void main() {
    Registration r = state.registration;
    match_moments(r);
    if (SHADES && correlation > 0.5) match_shading(r);
}
