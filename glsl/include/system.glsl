// The equation of a pixel for the step of the unknown, by D and b averaged over a window. Included after the images
// `unknown` and `weights`, the buffer `state` and the constants. CPU reference: src/engine/stages/system.rs.

#include "grid.glsl"

const int REACH = 16;                // pixels on either side for the slope of V
const int SUMS = 2;                  // q b, q², divided by D plus the smoothness

float at(ivec2 x) { return imageLoad(unknown, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r; }

float inverse_gradient(float rise_x, float rise_y) {
    return inversesqrt(0.25 * rate * (rise_x * rise_x + rise_y * rise_y) + smoothness_eta * smoothness_eta);
}

// The rise of V from a pixel to the next, by its slopes over REACH pixels before and behind: their harmonic mean, 0
// where they differ in sign.
float slope(float far_before, float here, float next, float far_behind) {
    float before = here - far_before, behind = far_behind - next;
    return before * behind > 0.0 ? before * behind / (0.5 * float(REACH) * (before + behind)) : 0.0;
}

// The right side and the weights are divided by the diagonal.
struct Equation {
    float right_side;
    vec4 weights;                    // of the right, left, lower and upper neighbour
    vec4 cell;                       // as that of a grid
    float over;                      // one divided by the diagonal
};

Equation equation(ivec2 x, float d, float b) {
    const ivec2 R = ivec2(1, 0), D = ivec2(0, 1);
    float here = at(x), right = at(x + R), left = at(x - R), below = at(x + D), above = at(x - D);
    float right_below = at(x + R + D), left_below = at(x - R + D);
    float right_above = at(x + R - D), left_above = at(x - R - D);
    vec4 phis = vec4(inverse_gradient(at(x + 2 * R) - here, right_below - right_above),
                     inverse_gradient(here - at(x - 2 * R), left_below - left_above),
                     inverse_gradient(right_below - left_below, at(x + 2 * D) - here),
                     inverse_gradient(right_above - left_above, here - at(x - 2 * D)));
    bvec4 exists = bvec4(x.x + 1 < width, x.x > 0, x.y + 1 < height, x.y > 0);
    float half_alpha = 0.5 * rate * (SWEEP ? alpha : alpha * state.alpha);
    vec4 a = mix(vec4(0.0), half_alpha * (inverse_gradient(right - left, below - above) + phis), exists);
    vec4 rises = vec4(right, left, below, above) - here;
    if (!SWEEP) {
        const ivec2 NEAR = ivec2(REACH, 0), FAR = ivec2(REACH + 1, 0);
        rises -= vec4(slope(at(x - NEAR), here, right, at(x + FAR)),
                      -slope(at(x - FAR), left, here, at(x + NEAR)),
                      slope(at(x - NEAR.yx), here, below, at(x + FAR.yx)),
                      -slope(at(x - FAR.yx), above, here, at(x + NEAR.yx)));
    }
    float pull = dot(a, rises);
    float over = 1.0 / max(d + (a.x + a.y + (a.z + a.w)), 1e-12);
    return Equation((b + pull) * over, a * over, vec4(d, b + pull, a.x, a.z), over);
}

// Where the weights of a pixel are: its column and row, and its color.
ivec3 place_of(ivec2 x) { return ivec3(x.x >> 1, x.y, x.x + x.y & 1); }

// The pixel beyond an odd width is relaxed too. A weight of zero cancels it unless it is NaN.
bool is_beside_surplus(ivec2 x) { return x.x + 1 == width && (width & 1) == 1; }

void store_weights(ivec2 x, vec4 w) {
    ivec3 place = place_of(x);
    // To the nearest number of half precision. Drivers may round towards zero, lavapipe does: sums of weights would be
    // too small everywhere, as if D were larger, and dV in textureless areas too small.
    w = uintBitsToFloat(floatBitsToUint(w) + 0x1000u & ~0x1fffu);
    imageStore(weights, place, w);
    if (is_beside_surplus(x)) imageStore(weights, ivec3(place.xy, 1 - place.z), vec4(0.0));
}

// What a pixel adds to the sums of a sweep.
vec2 sums_of(Equation e, float b, float q) { return q * e.over * vec2(b, q); }

shared vec2 by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4];

// Stores the sums of the workgroup.
void store_sums(vec2 sums) {
    vec2 sum = subgroupAdd(sums);
    if (subgroupElect()) by_subgroup[gl_SubgroupID] = sum;
    barrier();
    if (gl_LocalInvocationIndex != 0) return;
    sum = vec2(0.0);
    for (uint group = 0; group < gl_NumSubgroups; group++) sum += by_subgroup[group];
    uint row = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    partials[SUMS * row] = sum.x;
    partials[SUMS * row + 1] = sum.y;
}
