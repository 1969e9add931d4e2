#version 460
// Averages what speaks for an outline along the edge, so that an edge is moved as a whole. CPU reference:
// src/engine/stages/edge_agree.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform image2DArray results;
layout(push_constant) uniform Constants {
    int width, height;
    int from, to;                    // first numbers of the decisions
};

#include "edge.glsl"

const int NUMBERS = 6;
const int AROUND = 3;                // cells in each direction

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy), count = ivec2(width, height) / SIDE;
    if (any(greaterThanEqual(cell, count))) return;
    Edge edge = edge_of(cell);
    if (!edge.exists) return;
    float sums[NUMBERS] = float[](0.0, 0.0, 0.0, 0.0, 0.0, 0.0), sum = 0.0;
    ivec2 low = max(cell - AROUND, ivec2(0)), high = min(cell + AROUND, count - 1);
    for (int y = low.y; y <= high.y; y++) {
        for (int x = low.x; x <= high.x; x++) {
            Edge neighbour = edge_of(ivec2(x, y));
            float weight = neighbour.exists ? agreement(edge, neighbour) : 0.0;
            if (weight == 0.0) continue;
            sum += weight;
            for (int n = 0; n < NUMBERS; n++) sums[n] += weight * number_of(ivec2(x, y), DECISIONS, from + n);
        }
    }
    for (int n = 0; n < NUMBERS; n++) imageStore(results, place_of(cell, DECISIONS, to + n), vec4(sums[n] / sum));
}
