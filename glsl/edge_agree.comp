#version 460
// Averages the evidence for an outline along the edge, so that an edge is moved as a whole. A workgroup for each cell
// with an edge. CPU reference: src/engine/stages/edge_agree.rs.

layout(local_size_x = 128, local_size_y = 1, local_size_x_id = 0, local_size_y_id = 1) in;
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

// Numbers of the evidence for an outline; behind them the weight.
const int EVIDENCE = 6, NUMBERS = EVIDENCE + 1;
const int AROUND = 5;                // cells in each direction

#include "edge_around.glsl"

void main() {
    ivec2 cell = listed_cell();
    if (cell.x < 0) return;
    int lane = int(gl_LocalInvocationID.x);
    if (lane < NEIGHBOURS) {
        ivec2 other = cell_around(cell, lane);
        Edge neighbour = edge_of(is_inside(other) ? other : cell);
        float weight = is_inside(other) && neighbour.exists ? agreement(edge_of(cell), neighbour) : 0.0;
        for (int n = 0; n < EVIDENCE; n++) {
            terms[lane][n] = weight == 0.0 ? 0.0 : weight * number_of(other, DECISIONS, from + n);
        }
        terms[lane][EVIDENCE] = weight;
    }
    add_terms(lane);
    if (lane >= EVIDENCE) return;
    imageStore(results, place_of(cell, DECISIONS, to + lane), vec4(sum_of(lane) / sum_of(EVIDENCE)));
}
