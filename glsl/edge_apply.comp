#version 460
// V and its standard deviation at the depth edges whose outlines two layers explain. CPU reference:
// src/engine/stages/edge_apply.rs.

#include "nan.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform image2DArray relative_blur;
layout(binding = 1, r32f) uniform image2DArray results;
layout(binding = 2, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int decided;                     // first number of the decisions
    float spread;                    // σ² of the weights of cells along the edge, px²
    // By how much an outline must cost less than V as it is where residuals are independent, per cell.
    float least_saving;
    // Not 0 on a coarser level than the finest, where V of both sides is kept, and by which share each counts.
    int coarse;
};

#include "edge.glsl"

// Cells in each direction that an outline is taken from, and in which cells with an outline are counted.
const int AROUND = 4;
// By how much an outline must cost less than V as it is where all residuals are correlated with their neighbours.
const float CORRELATED = 8.0;
// More cells than this, with the cell itself, must continue the edge: five lie within two cells on a straight one.
const float LEAST_LENGTH = 4.5;
// Cells around with an outline of the same order, with the cell itself, without which an outline does not count.
const int LEAST_AROUND = 6;
// By how much an outline must cost less than the other order, per cell.
const float ORDER = 3.0;
// The largest variance of an outline's displacement, px² of the level: where residuals are independent, and where all
// are correlated.
const float MOST_VARIANCE = 4.0, CORRELATED_VARIANCE = 1.0;
// The farthest pixels that change, px from where V was halfway, and from where on they change less.
const float FARTHEST = 13.0, FADING = 9.0;
// σ² of the weights of cells by the pixel's distance from the edge, px².
const float AWAY = 16.0;

// Cells of the workgroup and those around whose outlines are counted.
const int COLUMNS = int(gl_WorkGroupSize.x) / CELL + 4 * AROUND, LINES = int(gl_WorkGroupSize.y) / CELL + 4 * AROUND;
// A bit for each cell, two words a row: whether an outline is accepted with the near side in front, and with the far
// side; and whether enough are around it.
shared uint accepted[2 * LINES], kept[2 * LINES];

// 0: V stays; 1: the near side is in front; 2: the far side is.
int order_of(ivec2 cell) {
    if (any(lessThan(cell, ivec2(0))) || any(greaterThanEqual(cell, ivec2(width, height) / CELL))) return 0;
    if (number_of(cell, EDGES, 0) == 0.0) return 0;
    float margin = number_of(cell, DECISIONS, decided + 4);
    int reversed = margin < 0.0 ? 1 : 0;
    float least = mix(least_saving, CORRELATED, state.correlated);
    float most = mix(MOST_VARIANCE, CORRELATED_VARIANCE, state.correlated);
    bool accepted = abs(margin) > ORDER && number_of(cell, DECISIONS, decided + reversed) > least
        && number_of(cell, DECISIONS, decided + 2 + reversed) < most
        && number_of(cell, DECISIONS, decided + 5) > LEAST_LENGTH;
    return accepted ? 1 + reversed : 0;
}

// The bits of the cells around a cell, from its row and column on.
uint around(uint row, int column) {
    return (row >> (column - AROUND)) & ((1u << (2 * AROUND + 1)) - 1u);
}

// The probability that a place `inside` px inside the outline's start is in front.
float in_front(ivec2 cell, int outlines, float inside) {
    float place = clamp(inside + float(BACKWARD) + 1.0, 0.0, float(DISPLACEMENTS));
    int n = int(place);
    float below = n == 0 ? 0.0 : number_of(cell, outlines, n - 1);
    return n == DISPLACEMENTS ? below : mix(below, number_of(cell, outlines, n), place - float(n));
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    ivec2 corner = ivec2(gl_WorkGroupID.xy * gl_WorkGroupSize.xy) / CELL - 2 * AROUND;
    int step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    if (gl_LocalInvocationIndex < 2 * LINES) {
        accepted[gl_LocalInvocationIndex] = 0;
        kept[gl_LocalInvocationIndex] = 0;
    }
    barrier();
    for (int n = int(gl_LocalInvocationIndex); n < COLUMNS * LINES; n += step) {
        int order = order_of(corner + ivec2(n % COLUMNS, n / COLUMNS));
        if (order > 0) atomicOr(accepted[2 * (n / COLUMNS) + order - 1], 1u << (n % COLUMNS));
    }
    barrier();
    int columns = COLUMNS - 2 * AROUND, lines = LINES - 2 * AROUND;
    for (int n = int(gl_LocalInvocationIndex); n < 2 * columns * lines; n += step) {
        int order = n % 2, column = AROUND + n / 2 % columns, line = AROUND + n / 2 / columns, count = 0;
        if ((accepted[2 * line + order] >> column & 1u) == 0u) continue;
        for (int j = line - AROUND; j <= line + AROUND; j++) count += bitCount(around(accepted[2 * j + order], column));
        if (count >= LEAST_AROUND) atomicOr(kept[2 * line + order], 1u << column);
    }
    barrier();
    if (x.x >= width || x.y >= height) return;
    ivec2 own = x / CELL - corner;
    float sum = 0.0, nearest = 1e30;
    vec4 levels = vec4(0.0);
    float near_share = 0.0, near_in_front = 0.0, towards_near = 0.0;
    for (int j = own.y - AROUND; j <= own.y + AROUND; j++) {
        uvec2 orders = uvec2(around(kept[2 * j], own.x), around(kept[2 * j + 1], own.x));
        for (uint cells = orders.x | orders.y; cells != 0u; cells &= cells - 1u) {
            int i = findLSB(cells);
            int order = (orders.x >> i & 1u) != 0u ? 1 : 2;
            ivec2 cell = corner + ivec2(own.x - AROUND + i, j);
            Edge edge = edge_of(cell);
            vec2 apart = vec2(x) - edge.place;
            float inside = dot(apart, edge.normal), along = dot(apart, vec2(-edge.normal.y, edge.normal.x));
            if (abs(inside) > FARTHEST) continue;
            nearest = min(nearest, inside * inside + 4.0 * along * along);
            float near = order == 1 ? in_front(cell, OUTLINES, inside) : 1.0 - in_front(cell, REVERSED_OUTLINES, -inside);
            float weight = exp(-along * along / (2.0 * spread) - inside * inside / (2.0 * AWAY));
            sum += weight;
            near_share += weight * near;
            towards_near += weight * inside;
            if (order == 1) near_in_front += weight;
            levels += weight * vec4(edge.near, edge.far, edge.near_deviation, edge.far_deviation);
        }
    }
    if (sum < 1e-3) {
        if (coarse != 0) imageStore(results, ivec3(x, COARSE_SHARE), vec4(0.0));
        return;
    }
    float p = near_share / sum, near = shown_near(p);
    levels /= sum;
    towards_near /= sum;
    int deviation_layer = coarse != 0 ? COARSE_DEVIATION : 1;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r, deviation = imageLoad(results, ivec3(x, deviation_layer)).r;
    float share = clamp((FARTHEST - sqrt(nearest)) / (FARTHEST - FADING), 0.0, 1.0) * min(1.0, sum / 0.3);
    bool near_front = near_in_front > 0.5 * sum;
    float of_sides = mix(levels.w, levels.z, p);
    if (coarse != 0) {
        share = isnan(deviation) ? 0.0 : share;
        imageStore(relative_blur, ivec3(x, 0), vec4(levels.x));
        imageStore(results, ivec3(x, COARSE_FAR), vec4(levels.y));
        imageStore(results, ivec3(x, COARSE_DEVIATION), vec4(of_sides));
        imageStore(results, ivec3(x, COARSE_SHARE), vec4(near_front ? share : -share));
        imageStore(results, ivec3(x, COARSE_NEAR), vec4(p));
        imageStore(results, ivec3(x, COARSE_TOWARDS_NEAR), vec4(towards_near));
        return;
    }
    share *= change(towards_near, near);
    v = mix(v, mix(levels.y, levels.x, near), share);
    float mixed = deviation_between(p, near) * abs(levels.x - levels.y) + of_sides;
    imageStore(relative_blur, ivec3(x, 0), vec4(v));
    // By the sign of V, as the fused image takes the photographs.
    float front = near_front ? levels.x : levels.y;
    bool fused = levels.x * levels.y < 0.0 && !isnan(deviation) && share > 0.0;
    if (fused) imageStore(results, ivec3(x, SIDES), vec4(v * front > 0.0 ? abs(front) : -abs(front)));
    // Where there are no results, both are NaN.
    if (isnan(deviation)) return;
    imageStore(results, ivec3(x, 0), vec4(v));
    imageStore(results, ivec3(x, 1), vec4(mix(deviation, mixed, share)));
}
