// The equation of a pixel for the step of the unknown, by D and b averaged over a window. Included after the images
// `unknown` and `weights`, the buffer `state` and the constants. CPU reference: src/engine/stages/system.rs.

#include "grid.glsl"
#include "links.glsl"

const int SUMS = 2;                  // q b, q², divided by D plus the smoothness

// The right side and the weights are divided by the diagonal.
struct Equation {
    float right_side;
    vec4 weights;                    // of the right, left, lower and upper neighbour
    vec4 cell;                       // as that of a grid
    float over;                      // one divided by the diagonal
};

Equation equation(ivec2 x, float d, float b) {
    Links links = links_at(x, rate * (SWEEP ? alpha : alpha * state.alpha), rate);
    vec4 a = links.weights;
    float pull = dot(a, links.rough);
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
