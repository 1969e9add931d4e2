#version 460
// The linear system for the step of the unknown: V of a pair, or u of a sweep. Combines D and b, averaged over a
// window, with the smoothness; for a sweep also the step of c. Equations 26 to 28. CPU reference:
// src/engine/stages/system.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool SWEEP = false;
layout(binding = 0, r32f) uniform readonly image2DArray unknown;
layout(binding = 1, r32f) uniform readonly image2DArray normal_equations; // D, b, and for a sweep q: window means
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

#include "system.glsl"

shared vec4 cells[gl_WorkGroupSize.x * gl_WorkGroupSize.y];  // equations as those of a grid

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    vec2 sums = vec2(0.0);
    vec4 cell = vec4(0.0);
    if (x.x < width && x.y < height) {
        float d = imageLoad(normal_equations, ivec3(x, 0)).r, b = imageLoad(normal_equations, ivec3(x, 1)).r;
        Equation e = equation(x, d, b);
        cell = e.cell;
        ivec3 place = place_of(x);
        imageStore(right_sides, place, vec4(e.right_side));
        if (is_beside_surplus(x)) imageStore(right_sides, ivec3(place.xy, 1 - place.z), vec4(0.0));
        store_weights(x, e.weights);
        if (SWEEP) sums = sums_of(e, b, imageLoad(normal_equations, ivec3(x, 2)).r);
    }
    uint own = gl_LocalInvocationIndex, line = gl_WorkGroupSize.x;
    cells[own] = cell;
    barrier();
    // A workgroup begins at an even pixel, and its sides are even.
    if (all(equal(x % 2, ivec2(0))) && x.x < width && x.y < height) {
        int place = x.y / 2 * halved(ivec2(width, height)).x + x.x / 2;
        grid_equations[place] = sum_of(cells[own], cells[own + 1], cells[own + line], cells[own + line + 1]);
    }
    if (SWEEP) store_sums(sums);
}
