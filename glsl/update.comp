#version 460
// V ← V + share clamp(dV), and the count of the pixels that still move or are at the limit. A whole step may be kept, and
// the next one extrapolated from it. CPU reference: src/engine/stages/update.rs.

#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray red;
layout(binding = 1, r32f) uniform readonly image2DArray black;
layout(binding = 2, r32f) uniform image2DArray relative_blur;
layout(binding = 3, r32f) uniform readonly image2DArray normal_equations; // D, averaged over a window
layout(binding = 4, std430) buffer StateBuffer { State state; };
layout(binding = 5, r32f) uniform image2DArray kept; // layer KEPT: the sums of a whole step over blocks of 2 x 2 pixels
layout(push_constant) uniform Constants {
    int width, height;
    float largest_step;                  // px² of the level, or
    float relative_step;                 // a share of |V|, if that is more
    float limit;                         // px² of the level
    float share;                         // of dV that is added
    int extrapolation;                   // KEEP, EXTRAPOLATE, or 0
};

const int KEEP = 1, EXTRAPOLATE = 2, KEPT = 3;
// Bounds of the factor by which an extrapolated step is longer.
const float LEAST_FACTOR = 0.5, MOST_FACTOR = 2.0;

// A pixel moves if its step is more than the first share of its standard deviation, and far if more than the second.
const float STILL = 0.1, FAR = 0.5;
// Of the standard deviation: 1/(4π 4²), the window's effective pixels, and the square of its factor 1.8.
const float INDEPENDENT = 0.004973592, WIDER = 3.24;

bool moves(float change, float d, float share_of_deviation) {
    float step = share_of_deviation * share_of_deviation;
    return d * change * change > step * WIDER * INDEPENDENT * state.variance;
}

// Aitken: if steps change in proportion to what is left, the whole way is the step by this.
float factor(float change, float before) {
    return before == 0.0 ? 1.0 : max(1.0 / max(1.0 - change / before, 1.0 / MOST_FACTOR), LEAST_FACTOR);
}

// An invocation updates a block of 2 x 2 pixels, which share a factor.
void main() {
    ivec2 first = 2 * ivec2(gl_GlobalInvocationID.xy), end = min(first + 2, ivec2(width, height));
    uvec3 moving = uvec3(0);
    float before[4], change[4], sum = 0.0;
    [[unroll]] for (int n = 0; n < 4; n++) {
        ivec2 x = first + ivec2(n % 2, n / 2);
        if (any(greaterThanEqual(x, end))) continue;
        ivec3 h = ivec3(x.x / 2, x.y, 0);
        before[n] = imageLoad(relative_blur, ivec3(x, 0)).r;
        float most = max(largest_step, relative_step * abs(before[n]));
        change[n] = clamp((x.x + x.y & 1) == 0 ? imageLoad(red, h).r : imageLoad(black, h).r, -most, most);
        sum += change[n];
    }
    float taken = share;
    if (all(lessThan(first, end))) {
        ivec3 block = ivec3(gl_GlobalInvocationID.xy, KEPT);
        if (extrapolation == KEEP) imageStore(kept, block, vec4(sum));
        if (extrapolation == EXTRAPOLATE) taken *= factor(sum, imageLoad(kept, block).r);
    }
    [[unroll]] for (int n = 0; n < 4; n++) {
        ivec2 x = first + ivec2(n % 2, n / 2);
        if (any(greaterThanEqual(x, end))) continue;
        float after = clamp(before[n] + taken * change[n], -limit, limit);
        imageStore(relative_blur, ivec3(x, 0), vec4(after));
        float whole = clamp(before[n] + change[n], -limit, limit) - before[n];
        float d = imageLoad(normal_equations, ivec3(x, 0)).r;
        moving += uvec3(moves(whole, d, STILL), moves(whole, d, FAR), d > 0.0 && abs(after) == limit);
    }
    uvec3 total = subgroupAdd(moving);
    if (!subgroupElect()) return;
    if (total.x > 0) atomicAdd(state.moving, total.x);
    if (total.y > 0) atomicAdd(state.moving_far, total.y);
    if (total.z > 0) atomicAdd(state.at_limit, total.z);
}
