#version 460
// Averages what speaks for an outline along the edge, so that an edge is moved as a whole. A workgroup for each cell with
// an edge. CPU reference: src/engine/stages/edge_agree.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform image2DArray results;
layout(binding = 1, std430) readonly buffer Arguments { uint arguments[]; };
layout(binding = 2, std430) readonly buffer Listed { uint listed[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int from, to;                    // first numbers of the decisions
    uint argument_place;
};

#include "edge.glsl"
#include "edge_list.glsl"

const int NUMBERS = 6;
const int AROUND = 3;                // cells in each direction
const int SIDE_AROUND = 2 * AROUND + 1, NEIGHBOURS = SIDE_AROUND * SIDE_AROUND;

// The numbers of each neighbour times its weight, and the weight; then the sums over rows of neighbours.
shared float weighed[NEIGHBOURS][NUMBERS + 1], rows[SIDE_AROUND][NUMBERS + 1];

void main() {
    ivec2 cell = listed_cell();
    if (cell.x < 0) return;
    int lane = int(gl_LocalInvocationID.x);
    if (lane < NEIGHBOURS) {
        ivec2 other = cell + ivec2(lane % SIDE_AROUND, lane / SIDE_AROUND) - AROUND;
        float weight = 0.0;
        if (all(greaterThanEqual(other, ivec2(0))) && all(lessThan(other, ivec2(width, height) / SIDE))) {
            Edge neighbour = edge_of(other);
            if (neighbour.exists) weight = agreement(edge_of(cell), neighbour);
        }
        for (int n = 0; n < NUMBERS; n++) {
            weighed[lane][n] = weight == 0.0 ? 0.0 : weight * number_of(other, DECISIONS, from + n);
        }
        weighed[lane][NUMBERS] = weight;
    }
    barrier();
    int row = lane / (NUMBERS + 1), number = lane % (NUMBERS + 1);
    if (row < SIDE_AROUND) {
        float sum = 0.0;
        for (int i = 0; i < SIDE_AROUND; i++) sum += weighed[SIDE_AROUND * row + i][number];
        rows[row][number] = sum;
    }
    barrier();
    if (lane >= NUMBERS) return;
    vec2 sums = vec2(0.0);
    for (int i = 0; i < SIDE_AROUND; i++) sums += vec2(rows[i][lane], rows[i][NUMBERS]);
    imageStore(results, place_of(cell, DECISIONS, to + lane), vec4(sums.x / sums.y));
}
