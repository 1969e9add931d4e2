#version 460
// Steps T and the parallax together by the sums over windows, if the parallax is larger than chance makes it. One
// workgroup. CPU reference: src/engine/stages/parallax.rs.

#include "state.glsl"
#include "parallax.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) buffer StateBuffer { State state; };
layout(binding = 2, std430) writeonly buffer Arguments { uint arguments[]; };
layout(binding = 3, std430) readonly buffer AllArguments { uint start_arguments[]; };
layout(push_constant) uniform Constants {
    int windows;
    int level;                       // nothing changes once it has settled
    uint starts;                     // 1: also while there is no parallax
    int unknowns;                    // of T
    float factor;                    // pixels of the full-size image per pixel of this level
    float scale_length;              // L, the length that places are divided by, pixels
    int warp_place, warp_words;      // of the arguments of the passes that warp I2 again
};

// The least number of windows that count, by their pixels. With fewer, nothing changes.
const int LEAST_COUNT = 12;
// The least square of the parallax over its deviation by the scatter over the windows, times the share of the energy that
// it explains. Errors of the model explain little however sure they seem: of cameras that stood still it reached 0.8.
const float LEAST_EVIDENCE = 1.0;
// The least deviation of V over the photograph, px² of the full-size image: twice the error of V at noise 0.01. If V
// varies less, it says nothing of near and far. The least parallax of one such deviation, pixels of the full-size image:
// less changes V by less than its noise.
const float LEAST_SPREAD = 0.2, LEAST_MOVED = 0.02;
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
shared bool warps;

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
        float pull = i < OF_T || square == 0.0 ? 0.0
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

float square_over(float c[6], vec3 x) { return dot(x, over_positive(c, x)); }

void step_once(float x[ALL]) {
    float c[6], inverse[6];
    for (int n = 0; n < 6; n++) c[n] = scattered[n];
    state.parallax_moves = 0u;
    if (scattered[SCATTER - 1] < float(LEAST_COUNT)) return;
    for (int k = 0, at = 0; k < 3; k++) {
        for (int l = k; l < 3; l++, at++) inverse[at] = over_pivot(OF_T + k, ALL + 1 + l);
    }
    bool had = is_some(state.parallax);
    vec3 before = before();
    float count = totals[PIXELS], mean = totals[OF_V] / count, spread = sqrt(max(totals[SQUARE_OF_V] / count - mean * mean, 0.0));
    vec3 move = vec3(x[OF_T], x[OF_T + 1], x[OF_T + 2]), found = before + move;
    // To second order.
    float explained = 0.5 * dot(move, over_positive(inverse, move)) / (count * state.levels[level].energy);
    bool is_large = spread * factor * factor > LEAST_SPREAD && spread * factor * length(found) > LEAST_MOVED && square_over(c, found) * explained > LEAST_EVIDENCE;
    if (!had && !is_large) return;
    state.parallax_moves = uint(square_over(c, move) > MOVING && spread * length(move) > STILL);
    float share = min(1.0, LARGEST / max(spread * length(move), 1e-12));
    found = before + share * move;
    // T follows the parallax. Its own step is that of all pixels, elsewhere.
    vec3 pull = over_positive(inverse, move);
    for (int i = 0; i < OF_T; i++) {
        x[i] = 0.0;
        for (int k = 0; k < 3; k++) x[i] += over_pivot(i, ALL + 1 + k) * pull[k];
    }
    float over = share / scale_length, bent = over / (factor * scale_length);
    Registration moves = Registration(over * (x[2] + x[4]), over * (x[5] - x[3]), over * (x[3] + x[5]), over * (x[2] - x[4]),
                                      share * factor * x[0], share * factor * x[1], bent * x[6], bent * x[7], 0.0, 0.0);
    state.registration = after(state.registration, moves);
    float to_along = 1.0 / (factor * factor * scale_length);
    state.parallax = Parallax(found.x / factor, found.y / factor, to_along * found.z);
    state.parallax_deviation = Parallax(sqrt(c[0]) / factor, sqrt(c[3]) / factor, to_along * sqrt(c[5]));
    warps = !had && warp_words > 0;
    if (warps) state.levels[level].warps |= 1u << findMSB(state.levels[level].iterations);
}

void main() {
    if (state.levels[level].settled != 0u || starts == 0u && !is_some(state.parallax)) return;
    int n = int(gl_LocalInvocationIndex), invocations = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    if (n == 0) warps = false;
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
    barrier();
    for (int word = n; warps && word < warp_words; word += invocations) {
        arguments[warp_place + word] = start_arguments[warp_place + word];
    }
}
