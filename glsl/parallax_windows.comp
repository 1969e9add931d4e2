#version 460
// The normal equations for the step of T and of the parallax together, in windows of a level, one workgroup each. CPU
// reference: src/engine/stages/parallax_windows.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, unless there is parallax.
layout(constant_id = 3) const bool WARPED = false;

#include "blur.glsl"
#include "noise.glsl"
#include "mask.glsl"
#include "parallax.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray unknown;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of I2
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
    float scale_length;              // L, the length that places are divided by, pixels
    float eta, smoothness_eta;
    float elimination;               // share of Σa that damps the elimination of dV
    float mean[2];                   // of the kernel at variance 1
    Noise noise;                     // of either image
};

#include "pair.glsl"
#include "data.glsl"

const bool SWEEP = false;

#include "links.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

const int SIDE = 16;                 // of a window, pixels
const int AT_ONCE = SIDE * SIDE / 2; // whose numbers are in shared memory
// Of each pixel: the derivatives of S by the unknowns; the weight of their products, and that of the gradient; then what
// is added from PIXELS on. An odd length keeps rows in different banks.
const int WEIGHT = ALL, SIDE_WEIGHT = ALL + 1, ADDED = ALL + 2, ROWS = ADDED + NUMBERS - PIXELS;
shared float columns[ROWS][AT_ONCE + 1];

void store_pixel(int n, ivec2 x) {
    ivec2 size = ivec2(width, height);
    Registration r = state.registration;
    vec2 centre = vec2(centre[0], centre[1]);
    float v = at(x), share = 0.0, column[ROWS];
    for (int k = 0; k < ROWS; k++) column[k] = 0.0;
    vec2 d = displacement_of(r, state.parallax, vec2(x), v, factor, centre);
    Variances of = variances_at(v, state.separation / (factor * factor));
    if (inside(x, d, size, of, scale_of(r))) share = counts(x, d, size);
    if (share > 0.0) {
        Data t = data_term(r, of, sample_pair(x, d, of, factor), share, d, x);
        Links links = links_at(x, state.alpha, 1.0);
        vec2 p = (vec2(x) - centre) / scale_length;
        float diagonal = t.weight * t.by_v * t.by_v, over = 1.0 / max(diagonal + elimination * dot(links.weights, vec4(1.0)), 1e-12);
        float powers[6] = float[](1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y);
        for (int k = 0; k < OF_T; k++) {
            for (int c = 0; c < 2; c++) column[k] += float(SIGNS[k][c]) * powers[monomial(powers_of(k, c))] * t.by_place[c];
        }
        column[OF_T] = v * t.by_place.x;
        column[OF_T + 1] = v * t.by_place.y;
        column[OF_T + 2] = v * dot(p, t.by_place);
        float weight = broadened(t.psi) * t.weight;
        float of_scale = v * t.by_v, by_parallax = v * dot(t.by_place, parallax_by_v(state.parallax, vec2(x), factor, centre));
        column[WEIGHT] = weight * (1.0 - diagonal * over);
        column[SIDE_WEIGHT] = weight * (t.s + t.by_v * over * (dot(links.weights, links.rough) - t.weight * t.s * t.by_v));
        float added[NUMBERS - PIXELS] =
            float[](share, share * v, share * v * v, 0.5 * broadened(t.psi) * dot(links.weights * links.rises, links.rough), weight * of_scale * of_scale,
                    weight * by_parallax * by_parallax);
        for (int k = 0; k < NUMBERS - PIXELS; k++) column[ADDED + k] = added[k];
    }
    for (int k = 0; k < ROWS; k++) columns[k][n] = column[k];
}

void main() {
    if (state.levels[level].settled != 0u || !is_some(state.parallax)) return;
    ivec2 size = ivec2(width, height), windows = ivec2(grid[0], grid[1]), window = ivec2(gl_WorkGroupID.xy);
    ivec2 corner = (2 * window + 1) * size / (2 * windows) - SIDE / 2;
    int invocations = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y), number = int(gl_LocalInvocationIndex);
    // The rows whose product is added.
    int a = ADDED + number - PIXELS, b = -1, weight = -1;
    if (number < GRADIENT_OF_ALL) {
        a = 0;
        while (product_of(a + 1, a + 1) <= number) a++;
        b = a + number - product_of(a, a);
        weight = WEIGHT;
    } else if (number < PIXELS) {
        a = number - GRADIENT_OF_ALL;
        b = SIDE_WEIGHT;
    }
    float sum = 0.0;
    for (int first = 0; first < SIDE * SIDE; first += AT_ONCE) {
        for (int k = number; k < AT_ONCE; k += invocations) {
            store_pixel(k, corner + ivec2((first + k) % SIDE, (first + k) / SIDE));
        }
        barrier();
        for (int k = 0; number < NUMBERS && k < AT_ONCE; k++) {
            sum += columns[a][k] * (b < 0 ? 1.0 : columns[b][k]) * (weight < 0 ? 1.0 : columns[weight][k]);
        }
        barrier();
    }
    if (number < NUMBERS) partials[NUMBERS * (window.y * grid[0] + window.x) + number] = sum;
}
