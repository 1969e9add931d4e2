#version 460
// The linear system for the step of the unknown: V of a pair, or u of a sweep. Combines D and b, averaged over a
// window, with the smoothness; for a sweep also the step of c. Equations 26 to 28. CPU reference:
// src/engine/stages/system.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"
#include "grid.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool SWEEP = false;
layout(binding = 0, r32f) uniform readonly image2DArray unknown;
layout(binding = 1, r32f) uniform readonly image2DArray normal_equations; // D, b, and for a sweep q: averaged over a window
layout(binding = 2, r32f) uniform writeonly image2DArray right_sides;     // layer 0: red, layer 1: black
layout(binding = 3, rgba16f) uniform writeonly image2DArray weights;      // likewise; right, left, down, up
layout(binding = 4, std430) writeonly buffer Partials { float partials[]; };
layout(binding = 5, std430) readonly buffer StateBuffer { State state; };
layout(binding = 6, std430) writeonly buffer GridEquations { vec4 grid_equations[]; };  // of the first coarse grid
layout(push_constant) uniform Constants {
    int width, height;
    float alpha;                     // for a pair the factor on the state's α
    float rate;                      // c, px² of the level; 1 for a pair
    float smoothness_eta;
};

const int REACH = 16;                // pixels on either side for the slope of V
const int SUMS = 2;                  // q b, q², divided by D plus the smoothness
shared vec2 by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4];
shared vec4 cells[gl_WorkGroupSize.x * gl_WorkGroupSize.y];  // equations as those of a grid

float at(ivec2 x) { return imageLoad(unknown, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r; }

float inverse_gradient(float rise_x, float rise_y) {
    return inversesqrt(0.25 * rate * (rise_x * rise_x + rise_y * rise_y) + smoothness_eta * smoothness_eta);
}

// The rise of V from a pixel to the next, by its slopes over REACH pixels before and behind: their harmonic mean, 0
// where they differ in sign.
float slope(float far_before, float here, float next, float far_behind) {
    float before = here - far_before, behind = far_behind - next;
    return before * behind > 0.0 ? 2.0 * before * behind / (float(REACH) * (before + behind)) : 0.0;
}

// The right side and weights of a pixel. `cell` is its equation as that of a grid. Returns what it adds to the sums.
vec2 equation(ivec2 x, out vec4 cell) {
    const ivec2 R = ivec2(1, 0), D = ivec2(0, 1);
    float here = at(x), right = at(x + R), left = at(x - R), below = at(x + D), above = at(x - D);
    float right_below = at(x + R + D), left_below = at(x - R + D), right_above = at(x + R - D), left_above = at(x - R - D);
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
        rises -= vec4(slope(at(x - NEAR), here, right, at(x + FAR)), -slope(at(x - FAR), left, here, at(x + NEAR)),
                      slope(at(x - NEAR.yx), here, below, at(x + FAR.yx)), -slope(at(x - FAR.yx), above, here, at(x + NEAR.yx)));
    }
    float pull = dot(a, rises);
    float d = imageLoad(normal_equations, ivec3(x, 0)).r, b = imageLoad(normal_equations, ivec3(x, 1)).r;
    cell = vec4(d, b + pull, a.x, a.z);
    float over = 1.0 / max(d + a.x + a.y + a.z + a.w, 1e-12);
    ivec3 place = ivec3(x.x / 2, x.y, (x.x + x.y) % 2);
    imageStore(right_sides, place, vec4((b + pull) * over));
    imageStore(weights, place, a * over);
    if (x.x + 1 == width && width % 2 == 1) {
        // The pixel beyond an odd width is relaxed too. A weight of zero cancels it unless it is NaN.
        ivec3 left_out = ivec3(place.xy, 1 - place.z);
        imageStore(right_sides, left_out, vec4(0.0));
        imageStore(weights, left_out, vec4(0.0));
    }
    if (!SWEEP) return vec2(0.0);
    float q = imageLoad(normal_equations, ivec3(x, 2)).r;
    return q * over * vec2(b, q);
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    vec2 sums = vec2(0.0);
    vec4 cell = vec4(0.0);
    if (x.x < width && x.y < height) sums = equation(x, cell);
    uint own = gl_LocalInvocationIndex, line = gl_WorkGroupSize.x;
    cells[own] = cell;
    barrier();
    // A workgroup begins at an even pixel, and its sides are even.
    if (all(equal(x % 2, ivec2(0))) && x.x < width && x.y < height) {
        int place = x.y / 2 * halved(ivec2(width, height)).x + x.x / 2;
        grid_equations[place] = sum_of(cells[own], cells[own + 1], cells[own + line], cells[own + line + 1]);
    }
    if (!SWEEP) return;
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
