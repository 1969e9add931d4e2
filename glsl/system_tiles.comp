#version 460
// The linear system for the step of the unknown: V of a pair, or u of a sweep. Averages D and b over a window, combines
// them with the smoothness, for a sweep also for the step of c, and sums the system on the first grids of the cascade,
// by a workgroup for each tile. Equations 26 to 28. CPU reference: src/engine/stages/system_tiles.rs.

#extension GL_EXT_control_flow_attributes : require // arrays stay in registers only if loops are unrolled
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

const int VECTORS = 1024;            // of four weights: the 16 KiB that each device allows a uniform buffer

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool SWEEP = false;
layout(binding = 0, r32f) uniform readonly image2DArray unknown;
layout(binding = 1, r32f) uniform readonly image2DArray normal_equations; // D, b, and for a sweep q
layout(binding = 2, r32f) uniform writeonly image2DArray smoothed;  // layer 0: D averaged over the window; RIGHT_SIDE
layout(binding = 3, rgba16f) uniform writeonly image2DArray weights; // by color; right, left, down, up
layout(binding = 4, std430) writeonly buffer Partials { float partials[]; };
layout(binding = 5, std430) readonly buffer StateBuffer { State state; };
layout(binding = 6, std430) writeonly buffer GridEquations { vec4 grid_equations[]; };
layout(binding = 7, std140) uniform Filters { vec4 filters[VECTORS]; };
layout(push_constant) uniform Constants {
    int width, height;
    float alpha;                     // for a pair the factor on the state's α
    float rate;                      // c, px² of the level; 1 for a pair
    float smoothness_eta;
    int offset;                      // of the window among the vectors of weights
    int radius;                      // of the window
    int grids;                       // to store, at most GRIDS
};

const bool ANY = false;
const int BLOCK = 0, STRIDE = 1;

#include "filter.glsl"
#include "system.glsl"

const int RIGHT_SIDE = 1;            // the layer of the right sides
const int TOTAL = 256;               // invocations
const int TILE = 32;                 // pixels along x and y
const int CELLS = 16;                // of the first grid: one for an invocation
const int GRIDS = 5;                 // the last has one cell for a tile
const int LINES = 50;                // filtered along x, for TILE lines of means
const int LAYERS = SWEEP ? 3 : 2;
// Spans along x and along y of a layer, and rounds in which the invocations take those of all layers.
const int ALONG_X = LINES * TILE / SPAN, ALONG_Y = TILE * TILE / SPAN;
const int ROUNDS_X = (LAYERS * ALONG_X + TOTAL - 1) / TOTAL, ROUNDS_Y = (LAYERS * ALONG_Y + TOTAL - 1) / TOTAL;

// Filtered along x, then along both axes. One column more, so that lines begin in different banks.
shared float means[LAYERS][LINES][TILE + 1];
shared vec4 cells[CELLS * CELLS * 4 / 3];   // of all grids but the last, the finest first

// A pixel of the mirrored level. Twice: enough for sides of at least 6 pixels.
int mirrored(int place, int length) {
    int last = length - 1;
    return clamp(abs(last - abs(last - abs(place))), 0, last);
}

void filter_along_x(ivec2 corner) {
    [[unroll]] for (int round = 0; round < ROUNDS_X; round++) {
        int span = int(gl_LocalInvocationIndex) + round * TOTAL;
        if (span >= LAYERS * ALONG_X) continue;
        int layer = span / ALONG_X, line = span % ALONG_X / (TILE / SPAN), column = span % (TILE / SPAN) * SPAN;
        int y = mirrored(corner.y - radius + line, height), x = corner.x + column - radius;
        float values[VALUES];
        [[unroll]] for (int m = 0; m < VALUES; m++)
            values[m] = imageLoad(normal_equations, ivec3(mirrored(x + m, width), y, layer)).r;
        float sums[SPAN] = NONE;
        weigh(offset, values, sums);
        [[unroll]] for (int j = 0; j < SPAN; j++) means[layer][line][column + j] = sums[j];
    }
    barrier();
}

void filter_along_y() {
    float sums[ROUNDS_Y][SPAN];
    [[unroll]] for (int round = 0; round < ROUNDS_Y; round++) {
        int span = int(gl_LocalInvocationIndex) + round * TOTAL;
        int layer = min(span / ALONG_Y, LAYERS - 1), line = span % ALONG_Y / TILE * SPAN, column = span % TILE;
        float values[VALUES];
        [[unroll]] for (int m = 0; m < VALUES; m++) values[m] = means[layer][line + m][column];
        sums[round] = NONE;
        weigh(offset, values, sums[round]);
    }
    barrier();
    [[unroll]] for (int round = 0; round < ROUNDS_Y; round++) {
        int span = int(gl_LocalInvocationIndex) + round * TOTAL;
        if (span >= LAYERS * ALONG_Y) continue;
        int layer = span / ALONG_Y, line = span % ALONG_Y / TILE * SPAN, column = span % TILE;
        [[unroll]] for (int j = 0; j < SPAN; j++) means[layer][line + j][column] = sums[round][j];
    }
    barrier();
}

float mean_at(int layer, ivec2 x) { return means[layer][x.y][x.x]; }

// Stores the cells of the first grids. `sum` is this invocation's of the finest.
void store_grids(vec4 sum) {
    int index = int(gl_LocalInvocationIndex), to = 0, from = 0;
    ivec2 size = halved(ivec2(width, height));
    [[unroll]] for (int grid = 0; grid < GRIDS; grid++) {
        // The first invocations, row by row, take four cells each.
        const int side = CELLS >> grid;
        if (index < side * side) {
            if (grid > 0) {
                int first = from + 2 * (2 * side * (index / side) + index % side);
                sum = sum_of(cells[first], cells[first + 1], cells[first + 2 * side], cells[first + 2 * side + 1]);
            }
            ivec2 cell = side * ivec2(gl_WorkGroupID.xy) + ivec2(index % side, index / side);
            if (grid < grids && all(lessThan(cell, size))) grid_equations[to + cell.y * size.x + cell.x] = sum;
            if (grid > 0) from += 4 * side * side;
            if (grid + 1 < GRIDS) cells[from + index] = sum;
        }
        to += size.x * size.y;
        size = halved(size);
        barrier();
    }
}

void main() {
    ivec2 corner = TILE * ivec2(gl_WorkGroupID.xy);
    filter_along_x(corner);
    filter_along_y();
    int index = int(gl_LocalInvocationIndex);
    ivec2 block = 2 * ivec2(index % CELLS, index / CELLS);
    vec2 sums = vec2(0.0);
    vec4 quarters[4];
    [[unroll]] for (int n = 0; n < 4; n++) {
        ivec2 in_tile = block + ivec2(n & 1, n >> 1), x = corner + in_tile;
        quarters[n] = vec4(0.0);
        if (x.x >= width || x.y >= height) continue;
        float d = mean_at(0, in_tile), b = mean_at(1, in_tile);
        Equation e = equation(x, d, b);
        quarters[n] = e.cell;
        imageStore(smoothed, ivec3(x, 0), vec4(d));
        imageStore(smoothed, ivec3(x, RIGHT_SIDE), vec4(e.right_side));
        store_weights(x, e.weights);
        if (SWEEP) sums += sums_of(e, b, mean_at(2, in_tile));
    }
    store_grids(sum_of(quarters[0], quarters[1], quarters[2], quarters[3]));
    if (SWEEP) store_sums(sums);
}
