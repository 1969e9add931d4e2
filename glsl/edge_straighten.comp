#version 460
// Straightens edges: of each cell, the place and the normal on the line through the cells along its edge, and V of
// either side there. A workgroup for each cell with an edge. CPU reference: src/engine/stages/edge_straighten.rs.

layout(local_size_x = 128, local_size_y = 1, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform image2DArray results;
layout(binding = 1, std430) readonly buffer Arguments { uint arguments[]; };
layout(binding = 2, std430) readonly buffer Listed { uint listed[]; };
layout(push_constant) uniform Constants {
    int width, height;
    uint argument_place;
};

#include "edge.glsl"
#include "edge_list.glsl"

// The cells in each direction that the line goes through, and σ² of their weights, in cells.
const int AROUND = 4;
const float SPREAD = 4.0;
// Few cells do not determine the slope of the line: it is small unless they are farther along than this, px².
const float LEAST_VARIANCE = 1.0;
// V of either side is averaged over the cells with weights of this σ by its difference, as a share of the jump: the
// same edge may have another surface behind it some cells on.
const float ALIKE = 0.25;
// The weight; weighted, the places along the edge and along the normal, their product, and the first squared. The
// weight by V of the sides; weighted by it, V of either side.
const int NUMBERS = 8;

#include "edge_around.glsl"

void main() {
    ivec2 cell = listed_cell();
    if (cell.x < 0) return;
    int lane = int(gl_LocalInvocationID.x);
    Edge edge = edge_on(cell, false);
    vec2 tangent = vec2(-edge.normal.y, edge.normal.x);
    if (lane < NEIGHBOURS) {
        ivec2 other = cell_around(cell, lane), cells = other - cell;
        Edge neighbour = edge_on(is_inside(other) ? other : cell, false);
        float weight = is_inside(other) && neighbour.exists ? agreement(edge, neighbour) : 0.0;
        weight *= exp(-float(cells.x * cells.x + cells.y * cells.y) / (2.0 * SPREAD));
        vec2 apart = neighbour.place - edge.place, at = vec2(dot(apart, tangent), dot(apart, edge.normal));
        vec2 sides = vec2(neighbour.near, neighbour.far), off = sides - vec2(edge.near, edge.far);
        float least = ALIKE * (edge.near - edge.far), alike = exp(-dot(off, off) / (2.0 * least * least));
        float numbers[NUMBERS] =
            float[](1.0, at.x, at.y, at.x * at.y, at.x * at.x, alike, alike * sides.x, alike * sides.y);
        for (int n = 0; n < NUMBERS; n++) terms[lane][n] = weight == 0.0 ? 0.0 : weight * numbers[n];
    }
    add_terms(lane);
    if (lane >= 6) return;
    float sum = sum_of(0);
    vec2 mean = vec2(sum_of(1), sum_of(2)) / sum;
    float slope = (sum_of(3) / sum - mean.x * mean.y) / (sum_of(4) / sum - mean.x * mean.x + LEAST_VARIANCE);
    vec2 place = edge.place + (mean.y - slope * mean.x) * edge.normal;
    vec2 normal = normalize(edge.normal - slope * tangent);
    vec2 sides = vec2(sum_of(6), sum_of(7)) / sum_of(5);
    float numbers[6] = float[](place.x, place.y, normal.x, normal.y, sides.x, sides.y);
    imageStore(results, place_of(cell, EDGES, STRAIGHT + lane), vec4(numbers[lane]));
}
