#version 460
// The distribution of the outline's place in both orders, from the costs of the cells along the edge, and the
// evidence for it. A workgroup for each cell with an edge. CPU reference: src/engine/stages/edge_decide.rs.

layout(local_size_x = 64, local_size_y = 2, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform image2DArray results;
layout(binding = 1, std430) readonly buffer Arguments { uint arguments[]; };
layout(binding = 2, std430) readonly buffer Listed { uint listed[]; };
layout(push_constant) uniform Constants {
    int width, height;
    uint argument_place;
};

#include "edge.glsl"
#include "edge_list.glsl"

// Costs are averaged over this many cells in each direction along the edge, with weights of this σ², in cells.
const int AROUND = 2;
const float SPREAD = 1.44;
// The costs of neighbouring samples are not independent: a distribution is exp(-cost / TEMPERATURE).
const float TEMPERATURE = 1.5;
// Where the mean displacement is at an end of the range, a better one may lie beyond. Its variance is then taken to be
// this, px² of the level: the variance if all displacements in the range are equally probable.
const float OUTSIDE = 18.667;

const int SIDE_AROUND = 2 * AROUND + 1, NEIGHBOURS = SIDE_AROUND * SIDE_AROUND;
// A row of invocations per order. Invocation n adds the cost n % COSTS_OF_CELL of every PARTS-th neighbour.
const int COSTS_OF_CELL = DISPLACEMENTS + 1, PARTS = 4;

// Of each neighbour: how far it agrees, its weight, and the weight of its sums over pairs of frames.
shared vec3 neighbours[NEIGHBOURS];
// By order: the sums over the neighbours, and the density of the outline's place.
shared float parts[2][PARTS][COSTS_OF_CELL], densities[2][DISPLACEMENTS];

void main() {
    ivec2 cell = listed_cell(), count = ivec2(width, height) / CELL;
    if (cell.x < 0) return;
    int lane = int(gl_LocalInvocationID.x), order = int(gl_LocalInvocationID.y);
    if (order == 0 && lane < NEIGHBOURS) {
        ivec2 apart = ivec2(lane % SIDE_AROUND, lane / SIDE_AROUND) - AROUND, other = cell + apart;
        neighbours[lane] = vec3(0.0);
        if (all(greaterThanEqual(other, ivec2(0))) && all(lessThan(other, count))) {
            Edge neighbour = edge_of(other);
            float total = neighbour.exists ? number_of(other, EDGES, TOTAL) : 0.0;
            if (total != 0.0) {
                float agree = agreement(edge_of(cell), neighbour);
                float weight = agree * exp(-float(apart.x * apart.x + apart.y * apart.y) / (2.0 * SPREAD));
                neighbours[lane] = vec3(agree, weight, weight / total);
            }
        }
    }
    barrier();
    int n = lane % COSTS_OF_CELL, part = lane / COSTS_OF_CELL;
    float cost = 0.0, sum = 0.0, length = 0.0;
    for (int i = part; i < NEIGHBOURS; i += PARTS) {
        ivec2 other = clamp(cell + ivec2(i % SIDE_AROUND, i / SIDE_AROUND) - AROUND, ivec2(0), count - 1);
        float weight = neighbours[i].z;
        // Cells without an edge have no costs.
        float its = number_of(other, order == 0 ? COSTS : REVERSED_COSTS, n);
        cost += weight == 0.0 ? 0.0 : weight * its;
    }
    parts[order][part][n] = cost;
    for (int i = 0; i < NEIGHBOURS; i++) {
        length += neighbours[i].x;
        sum += neighbours[i].y;
    }
    // No pair of frames shows the edge: it stays as it is.
    if (sum == 0.0) length = -1e6;
    sum = max(sum, 1e-6);
    barrier();
    // By order: the least cost.
    float least[2];
    for (int o = 0; o < 2; o++) {
        for (int i = 0; i < DISPLACEMENTS; i++) {
            float total = parts[o][0][i] + parts[o][1][i] + parts[o][2][i] + parts[o][3][i];
            least[o] = i == 0 ? total : min(least[o], total);
            if (o == order && i == lane) cost = total;
        }
    }
    if (lane < DISPLACEMENTS) densities[order][lane] = exp(-(cost - least[order]) / (TEMPERATURE * sum));
    barrier();
    float total = 0.0, place = 0.0, share = 0.0;
    for (int i = 0; i < DISPLACEMENTS; i++) {
        float density = densities[order][i];
        total += density;
        place += float(i) * density;
        // The share of the distribution up to each displacement.
        share += i <= lane ? density : 0.0;
    }
    if (lane < DISPLACEMENTS) {
        imageStore(results, place_of(cell, order == 0 ? OUTLINES : REVERSED_OUTLINES, lane), vec4(share / total));
    }
    if (lane > 0) return;
    place /= total;
    float variance = 0.0;
    for (int i = 0; i < DISPLACEMENTS; i++) {
        float away = float(i) - place;
        variance += away * away * densities[order][i];
    }
    variance /= total;
    bool is_within = place > 1.0 && place < float(DISPLACEMENTS - 2);
    float before = 0.0;
    for (int i = 0; i < PARTS; i++) before += parts[order][i][BEFORE];
    imageStore(results, place_of(cell, DECISIONS, order), vec4((before - least[order]) / sum));
    imageStore(results, place_of(cell, DECISIONS, 2 + order), vec4(is_within ? variance : OUTSIDE));
    if (order > 0) return;
    imageStore(results, place_of(cell, DECISIONS, 4), vec4((least[1] - least[0]) / sum));
    imageStore(results, place_of(cell, DECISIONS, 5), vec4(length));
}
