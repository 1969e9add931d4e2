#version 460
// The distribution of the outline's place in both orders, from the costs of the cells along the edge, and what speaks for
// it. CPU reference: src/engine/stages/edge_decide.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform image2DArray results;
layout(push_constant) uniform Constants {
    int width, height;
};

#include "edge.glsl"

// Costs are averaged over this many cells in each direction along the edge, with weights of this σ², in cells.
const int AROUND = 2;
const float SPREAD = 1.44;
// The costs of neighbouring samples are not independent: a distribution is exp(-cost / TEMPERATURE).
const float TEMPERATURE = 1.5;

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy), count = ivec2(width, height) / SIDE;
    if (any(greaterThanEqual(cell, count))) return;
    Edge edge = edge_of(cell);
    if (!edge.exists) return;
    float costs[2][DISPLACEMENTS], before[2] = float[](0.0, 0.0), sum = 0.0, length = 0.0;
    for (int n = 0; n < DISPLACEMENTS; n++) costs[0][n] = costs[1][n] = 0.0;
    ivec2 low = max(cell - AROUND, ivec2(0)), high = min(cell + AROUND, count - 1);
    for (int y = low.y; y <= high.y; y++) {
        for (int x = low.x; x <= high.x; x++) {
            ivec2 other = ivec2(x, y), apart = other - cell;
            Edge neighbour = edge_of(other);
            float total = neighbour.exists ? number_of(other, EDGES, TOTAL) : 0.0;
            if (total == 0.0) continue;
            float agree = agreement(edge, neighbour);
            length += agree;
            float weight = agree * exp(-float(apart.x * apart.x + apart.y * apart.y) / (2.0 * SPREAD));
            if (weight == 0.0) continue;
            sum += weight;
            weight /= total;
            before[0] += weight * number_of(other, COSTS, BEFORE);
            before[1] += weight * number_of(other, REVERSED_COSTS, BEFORE);
            for (int n = 0; n < DISPLACEMENTS; n++) {
                costs[0][n] += weight * number_of(other, COSTS, n);
                costs[1][n] += weight * number_of(other, REVERSED_COSTS, n);
            }
        }
    }
    // No pair of frames shows the edge: it stays as it is.
    if (sum == 0.0) length = -1e6;
    sum = max(sum, 1e-6);
    // By order: the least cost, and whether the outline is well within the displacements.
    float least[2];
    for (int order = 0; order < 2; order++) {
        least[order] = costs[order][0];
        for (int n = 1; n < DISPLACEMENTS; n++) least[order] = min(least[order], costs[order][n]);
        float total = 0.0, place = 0.0;
        for (int n = 0; n < DISPLACEMENTS; n++) {
            costs[order][n] = exp(-(costs[order][n] - least[order]) / (TEMPERATURE * sum));
            total += costs[order][n];
            place += float(n) * costs[order][n];
        }
        // The share of the distribution up to each displacement.
        float share = 0.0;
        for (int n = 0; n < DISPLACEMENTS; n++) {
            share += costs[order][n] / total;
            imageStore(results, place_of(cell, order == 0 ? OUTLINES : REVERSED_OUTLINES, n), vec4(share));
        }
        place /= total;
        float within = place > 1.0 && place < float(DISPLACEMENTS - 2) ? 1.0 : 0.0;
        imageStore(results, place_of(cell, DECISIONS, order), vec4((before[order] - least[order]) / sum));
        imageStore(results, place_of(cell, DECISIONS, 2 + order), vec4(within));
    }
    imageStore(results, place_of(cell, DECISIONS, 4), vec4((least[1] - least[0]) / sum));
    imageStore(results, place_of(cell, DECISIONS, 5), vec4(length));
}
