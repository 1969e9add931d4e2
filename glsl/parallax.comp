#version 460
// Steps T and the parallax together by the sums over windows. One workgroup. CPU reference: src/engine/stages/parallax.rs.

#include "state.glsl"
#include "parallax.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int windows;
    int level;                       // nothing changes once it has settled
    int unknowns;                    // of T
    float factor;                    // pixels of the full-size image per pixel of this level
    float scale_length;              // L, the length that places are divided by, pixels
};

// The least number of windows that count, by their pixels. With fewer, nothing changes.
const int LEAST_COUNT = 12;
// The share of the evidence for the scale of V from which on the parallax keeps its size: displacement is all of it.
const float DISPLACED = 0.9;
// The standard deviation of that size, as a share.
const float OF_START = 0.4;
// The largest step of the parallax, of one deviation of V, pixels of the level.
const float LARGEST = 0.3;
// A level settles only once the square of the parallax's step over its deviation is less than MOVING, or the step of one
// deviation of V less than STILL, pixels of the level.
const float MOVING = 0.3, STILL = 0.001;
// Below this a pivot has no digits left in single precision.
const float LEAST_PIVOT = 1e-5;
const int COLUMNS = ALL + 4;         // N scaled to a unit diagonal, by rows; -g; the unit vectors of the parallax
const int SCATTER = 7;               // the upper triangle of the covariance of the parallax, and the windows that count

shared float totals[NUMBERS];
shared float scales[ALL];
shared float equations[ALL][COLUMNS];
shared float scatter[gl_WorkGroupSize.x * gl_WorkGroupSize.y][SCATTER];
shared float scattered[SCATTER];

float normal(int row, int i, int j) { return partials[NUMBERS * row + product_of(i, j)]; }

// The parallax on the level: px per px², and the same at L.
vec3 before() {
    Parallax p = state.parallax;
    return factor * vec3(p.across_x, p.across_y, factor * scale_length * p.along);
}

// The step and the rows of the inverse of N for the parallax, by Gauss and Jordan.
void solve() {
    int n = int(gl_LocalInvocationIndex), i = n / COLUMNS, j = n % COLUMNS;
    bool mine = i < ALL;
    if (n < ALL) {
        float diagonal = totals[product_of(n, n)];
        bool is_held = n >= unknowns && n < OF_T || !(diagonal > 0.0);
        scales[n] = is_held ? 0.0 : inversesqrt(diagonal);
    }
    barrier();
    float own = 0.0;
    if (mine) {
        // -g. The smoothness would make V smaller and the parallax larger: what it pulls, as far as V is by parallax, is taken
        // from the parallax.
        vec3 p = before();
        float square = dot(p, p);
        float pull = i < OF_T ? 0.0
            : totals[ROUGHNESS_OF_V] * totals[BY_PARALLAX] / max(totals[EVIDENCE], 1e-30) * p[i - OF_T] / square;
        own = j < ALL ? scales[i] * scales[j] * totals[product_of(i, min(j, ALL - 1))]
            : j == ALL ? -scales[i] * (totals[GRADIENT_OF_ALL + i] + pull)
            : i == OF_T + j - ALL - 1 ? scales[i] : 0.0;
        equations[i][j] = own;
    }
    barrier();
    for (int k = 0; k < ALL; k++) {
        float pivot = equations[k][k];
        bool counts = pivot > LEAST_PIVOT;
        if (mine && i != k) own = counts ? own - equations[i][k] * equations[k][j] / pivot : j == k ? 0.0 : own;
        if (mine && i == k && !counts) own = 0.0;
        barrier();
        if (mine) equations[i][j] = own;
        barrier();
    }
}

float over_pivot(int i, int column) {
    return equations[i][i] > 0.0 ? equations[i][column] / equations[i][i] * scales[i] : 0.0;
}

// x = C⁻¹ y of a positive C by its upper triangle; 0 if C is not positive.
vec3 over_positive(float c[6], vec3 y) {
    float b = c[1] / c[0], d = c[2] / c[0], e = c[3] - b * c[1], f = c[4] - d * c[1], h = f / e, g = c[5] - d * c[2] - h * f;
    if (!(c[0] > 0.0 && e > 0.0 && g > 0.0)) return vec3(0.0);
    float y1 = y.y - b * y.x, z = (y.z - d * y.x - h * y1) / g, x1 = y1 / e - h * z;
    return vec3(y.x / c[0] - b * x1 - d * z, x1, z);
}

// Adds the scatter of a window: what its own gradient at the step would move the parallax.
void add_scatter(int row, float x[ALL], inout float sums[SCATTER]) {
    if (!(partials[NUMBERS * row + PIXELS] > 0.0)) return;
    float moves[3] = float[](0.0, 0.0, 0.0);
    for (int i = 0; i < ALL; i++) {
        float left = partials[NUMBERS * row + GRADIENT_OF_ALL + i];
        for (int j = 0; j < ALL; j++) left += normal(row, i, j) * x[j];
        for (int k = 0; k < 3; k++) moves[k] += over_pivot(i, ALL + 1 + k) * left;
    }
    for (int k = 0, at = 0; k < 3; k++) {
        for (int l = k; l < 3; l++, at++) sums[at] += moves[k] * moves[l];
    }
    sums[SCATTER - 1] += 1.0;
}

void step_once(float x[ALL]) {
    float c[6], inverse[6];
    for (int n = 0; n < 6; n++) c[n] = scattered[n];
    state.parallax_moves = 0u;
    if (scattered[SCATTER - 1] < float(LEAST_COUNT)) return;
    for (int k = 0, at = 0; k < 3; k++) {
        for (int l = k; l < 3; l++, at++) inverse[at] = over_pivot(OF_T + k, ALL + 1 + l);
    }
    vec3 before = before();
    float count = totals[PIXELS], mean = totals[OF_V] / count, spread = sqrt(max(totals[SQUARE_OF_V] / count - mean * mean, 0.0));
    vec3 move = vec3(x[OF_T], x[OF_T + 1], x[OF_T + 2]);
    bool holds_size = totals[BY_PARALLAX] > DISPLACED * totals[EVIDENCE];
    // The coarser levels have found its direction, and the finest settles.
    if (holds_size) move = level == 0 ? vec3(0.0) : move - dot(before, move) / dot(before, before) * before;
    state.parallax_size = holds_size ? OF_START : 0.0;
    state.parallax_moves = uint(dot(move, over_positive(c, move)) > MOVING && spread * length(move) > STILL);
    float share = min(1.0, LARGEST / max(spread * length(move), 1e-12));
    vec3 found = before + share * move;
    // T follows the parallax. Its own step is that of all pixels, elsewhere.
    vec3 pull = over_positive(inverse, move);
    float of_t[OF_T];
    for (int i = 0; i < OF_T; i++) {
        of_t[i] = 0.0;
        for (int k = 0; k < 3; k++) of_t[i] += share * over_pivot(i, ALL + 1 + k) * pull[k];
    }
    state.registration = after(state.registration, step_of(of_t, factor, scale_length));
    float to_along = 1.0 / (factor * factor * scale_length);
    state.parallax = Parallax(found.x / factor, found.y / factor, to_along * found.z);
    vec3 deviations = sqrt(vec3(c[0], c[3], c[5]));
    state.parallax_deviation = Parallax(deviations.x / factor, deviations.y / factor, to_along * deviations.z);
}

void main() {
    if (state.levels[level].settled != 0u || !is_some(state.parallax)) return;
    int n = int(gl_LocalInvocationIndex), invocations = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int number = n; number < NUMBERS; number += invocations) {
        float sum = 0.0;
        for (int row = 0; row < windows; row++) sum += partials[NUMBERS * row + number];
        totals[number] = sum;
    }
    barrier();
    solve();
    float x[ALL], sums[SCATTER];
    for (int i = 0; i < ALL; i++) x[i] = over_pivot(i, ALL);
    for (int k = 0; k < SCATTER; k++) sums[k] = 0.0;
    for (int row = n; row < windows; row += invocations) add_scatter(row, x, sums);
    for (int k = 0; k < SCATTER; k++) scatter[n][k] = sums[k];
    barrier();
    if (n < SCATTER) {
        float sum = 0.0;
        for (int k = 0; k < invocations; k++) sum += scatter[k][n];
        scattered[n] = sum;
    }
    barrier();
    if (n == 0) step_once(x);
}
