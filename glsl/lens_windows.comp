#version 460
// Compares candidates for the law and the kernel by what they leave of the residual in windows of the photographs, one
// workgroup each. CPU reference: src/engine/stages/lens_windows.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;

#include "blur.glsl"
#include "lens.glsl"
#include "mask.glsl"
#include "noise.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of the warped I2
layout(binding = 2, std430) readonly buffer StateBuffer { State state; };
layout(binding = 3, r32f) uniform readonly image2DArray masks;          // of I1, of I2
layout(binding = 4, std430) writeonly buffer Partials { float partials[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int second_stack;                // its first layer
    int grid[2];                     // columns and rows of windows
    int level;                       // nothing is done once it has settled
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    uint are_gaussian;               // the stacks have just been computed, for a Gaussian
    Noise noise;                     // of either image
};

#include "coefficients.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

const int SIDE = 24, STEP = 2;       // of a window, pixels; from a sample to the next
const int ALONG = SIDE / STEP;
const float COUNTED = 0.99;          // rounding of the averaged mask: 2e-5
// The terms of S: the window's own V, t_x, t_y, offset and gain; and S itself.
const int TERMS_OF_S = 6, LEFT = 5;
const int PAIRS = TERMS_OF_S * (TERMS_OF_S + 1) / 2;
// Windows of wider blur say nothing: it is smooth over the window. px² of the level.
const float WIDEST = 12.0;
// The least square of S over the power of its noise: a fifth of that of rounding to 256 values.
const float LEAST_SQUARE = 2.5e-7;
// The noise under a disk of variance v and then a Gaussian of variance w, as a share of that under a Gaussian of both:
// 1 - FLAT x² + FLATTER x⁴, x = v/(v + w + PIXEL).
const float FLAT = 0.23, FLATTER = 0.13, PIXEL = 0.1;
const int MOST_NODES = 24;           // of a stack
const int GAUSSIAN = 0, DISK = 1;
shared float by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][PAIRS];
shared bool is_whole;                // whether the window counts

// Of this invocation: the nodes of both stacks at its pixel, value, gradient and slope; V in px² of the level.
vec4 of_first[MOST_NODES], of_second[MOST_NODES];
float v, around;
// The derivative of the parallax by V. The variance in the pixels of I2's stack of a blur of 1 px² in those of I1.
vec2 parallax;
float square_scale;
bool is_counted;

vec4 node_of(int image, int k) { return image == 1 ? of_first[k] : of_second[k]; }

// A Gaussian's image at a variance: value, gradient and slope.
vec4 gaussian_at(int image, float variance) {
    int k = node_below(variance, nodes);
    vec4 p = node_of(image, k), q = node_of(image, k + 1);
    Blurred blurred = between(k, variance, Blurred(p.x, p.w, p.yz), Blurred(q.x, q.w, q.yz));
    return vec4(blurred.value, blurred.gradient, blurred.slope);
}

// The departure of a disk of some variance that is blurred by a Gaussian of another, between two nodes.
float departure_at(int image, float variance, float more) {
    int k = node_below(variance, nodes);
    vec2 departures = vec2(0.0);
    for (int n = 0; n < 2; n++) {
        if (k + n == 0) continue;
        int row = departure_row(k + n, nodes);
        for (int m = 0; m < DEPARTURE_NODES; m++) {
            float weight = DEPARTURES[row + m];
            if (weight != 0.0) departures[n] += weight * gaussian_at(image, node_variance(k + n + m - 2) + more).x;
        }
    }
    return mix(departures.x, departures.y, min((variance - node_variance(k)) / (node_variance(k + 1) - node_variance(k)), 1.0));
}

// The power of white noise under a kernel of some variance and then a Gaussian of variance `more`.
Power noise_under(int kernel, float variance, float more) {
    Power power = blurred_power(noise, variance + more, 1.0);
    float x = kernel == DISK ? variance / (variance + more + PIXEL) : 0.0, share = 1.0 - (FLAT - FLATTER * x * x) * x * x;
    return Power(share * power.value, share * power.slope);
}

// The logarithm of the mean square of what the window's own V, t, offset and gain leave of S, over the power of white
// noise in it, with both images blurred more by a Gaussian; in the first invocation.
float left(int kernel, Variances of, float more) {
    float sums[PAIRS];
    for (int i = 0; i < PAIRS; i++) sums[i] = 0.0;
    if (is_counted) {
        Registration r = state.registration;
        vec4 first = gaussian_at(1, of.first + more), second = gaussian_at(2, square_scale * (of.second + more));
        float by_v = of.first_by_v * first.w - r.gain * (of.second_by_v * square_scale * second.w + dot(parallax, second.yz));
        if (kernel == DISK) {
            first.x += departure_at(1, of.first, more);
            second.x += departure_at(2, square_scale * of.second, square_scale * more);
        }
        Power one = noise_under(kernel, of.first, more), two = noise_under(kernel, of.second, more);
        float power = one.value + two.value, s = first.x - (r.gain * second.x + r.offset);
        by_v -= 0.5 * (one.slope * of.first_by_v + two.slope * of.second_by_v) / power * s;
        float terms[TERMS_OF_S] = float[](by_v, second.y, second.z, 1.0, second.x - around, s);
        for (int i = 0, at = 0; i < TERMS_OF_S; i++) {
            for (int j = i; j < TERMS_OF_S; j++, at++) sums[at] = terms[i] * terms[j] / power;
        }
    }
    for (int i = 0; i < PAIRS; i++) {
        float sum = subgroupAdd(sums[i]);
        if (subgroupElect()) by_subgroup[gl_SubgroupID][i] = sum;
    }
    barrier();
    float result = 0.0;
    if (gl_LocalInvocationIndex == 0) {
        float m[TERMS_OF_S][TERMS_OF_S], whole[TERMS_OF_S];
        for (int i = 0, n = 0; i < TERMS_OF_S; i++) {
            for (int j = i; j < TERMS_OF_S; j++, n++) {
                m[i][j] = 0.0;
                for (uint group = 0; group < gl_NumSubgroups; group++) m[i][j] += by_subgroup[group][n];
            }
            whole[i] = m[i][i];
        }
        for (int p = 0; p < LEFT; p++) {
            // A term that depends on the others is left with rounding errors.
            if (!(m[p][p] > 1e-5 * whole[p])) continue;
            for (int i = p + 1; i < TERMS_OF_S; i++) {
                for (int j = i; j < TERMS_OF_S; j++) m[i][j] -= m[p][i] * m[p][j] / m[p][p];
            }
        }
        result = log(max(m[LEFT][LEFT], 0.0) / float(ALONG * ALONG) + LEAST_SQUARE);
    }
    barrier();
    return result;
}

void main() {
    bool is_gaussian = are_gaussian != 0u || state.kernel_shape == 0.0;
    if (state.levels[level].settled != 0u || !is_gaussian) return;
    ivec2 size = ivec2(width, height), windows = ivec2(grid[0], grid[1]), window = ivec2(gl_WorkGroupID.xy);
    ivec2 corner = (2 * window + 1) * size / (2 * windows) - SIDE / 2;
    Registration r = state.registration;
    int first = NUMBERS * (window.y * grid[0] + window.x), sample_of = int(gl_LocalInvocationIndex);
    bool is_sample = sample_of < ALONG * ALONG;
    ivec2 x = corner + STEP * (is_sample ? ivec2(sample_of % ALONG, sample_of / ALONG) : ivec2(0));
    vec2 centre = vec2(centre[0], centre[1]), f;
    v = imageLoad(relative_blur, ivec3(x, 0)).r;
    vec2 d = displacement_of(r, state.parallax, vec2(x), v, factor, centre);
    around = unit_of_coefficients() * coefficient(2, ivec3(corner + SIDE / 2, 0));
    is_counted = is_sample && inside(x, d, size, variances_at(v, 0.0), scale_of(r)) && counts(x, d, size) >= COUNTED;
    vec2 counted = subgroupAdd(is_counted ? vec2(1.0, abs(v)) : vec2(0.0));
    if (subgroupElect()) {
        by_subgroup[gl_SubgroupID][0] = counted.x;
        by_subgroup[gl_SubgroupID][1] = counted.y;
    }
    barrier();
    if (sample_of == 0) {
        counted = vec2(0.0);
        for (uint group = 0; group < gl_NumSubgroups; group++) counted += vec2(by_subgroup[group][0], by_subgroup[group][1]);
        float mean = counted.y / float(ALONG * ALONG);
        is_whole = counted.x == float(ALONG * ALONG) && mean < WIDEST;
        partials[first + MEAN] = is_whole ? factor * factor * mean : -1.0;
    }
    barrier();
    if (!is_whole) return;
    ivec3 columns = beside(x.x, size.x), lines = beside(x.y, size.y);
    vec2 shift = displacement(moved_since(state.warped, r), x, factor, centre);
    // With parallax I2 is not on I1's pixels.
    bool is_apart = is_some(state.parallax);
    parallax = jacobian(r) * parallax_by_v(state.parallax, vec2(x), factor, centre);
    square_scale = is_apart ? scale_of(r) * scale_of(r) : 1.0;
    ivec2 i;
    place(x, d, size, i, f);
    for (int k = 0; k < nodes; k++) {
        Blurred one = node_on(1, k, columns, lines, vec2(0.0));
        Blurred two = is_apart ? node_at(2, k, size, i, f) : node_on(2, k, columns, lines, shift);
        of_first[k] = vec4(one.value, one.gradient, one.slope);
        of_second[k] = vec4(two.value, two.gradient, two.slope);
    }
    Variances relative = variances_at(v, 0.0);
    float ratio = left(GAUSSIAN, relative, 0.0) - left(DISK, relative, 0.0);
    if (sample_of == 0) partials[first] = ratio;
    int count = lenses(state.separation);
    for (int lens = 0; lens < count; lens++) {
        float square = factor * factor;
        Variances of = variances_at(v, separation_of(lens, state.separation) / square);
        Variances next = variances_at(v, separation_of(lens + 1, state.separation) / square);
        float own = left(DISK, of, 0.0);
        float kernel = left(GAUSSIAN, of, 0.0) - own, law = left(DISK, relative, max(of.second - relative.second, 0.0)) - own;
        float chain = left(DISK, next, max(of.second - next.second, 0.0)) - left(DISK, of, max(next.second - of.second, 0.0));
        if (sample_of == 0) {
            int at = first + 1 + OF_LENS * lens;
            partials[at + CHAIN] = chain;
            partials[at + KERNEL] = kernel;
            partials[at + LAW] = law;
        }
    }
}
