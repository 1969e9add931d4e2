#version 460
// Sums the linear system for dV of the finest grid up to the next coarser grids of the cascade, by a workgroup for each
// tile of 64 x 64 cells. CPU reference: src/engine/stages/halve_grids.rs.

#extension GL_EXT_control_flow_attributes : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer FinestEquations { vec4 equations[]; };
layout(binding = 1, std430) writeonly buffer GridEquations { vec4 coarser[]; };    // in the same buffer
#include "grid_equations.glsl"

layout(push_constant) uniform Constants {
    int width, height;               // of the finest grid
    int first;                       // its first cell
    int grids;                       // coarser grids, at most GRIDS
};

const int GRIDS = 6;                 // one cell for a tile
const int SIDE = 16;                 // invocations along x and y: a cell each of the second coarser grid
shared vec4 sums[SIDE * SIDE];       // equations of the tile, of one grid

int to;                              // first cell of the grid that is written
ivec2 size;                          // its size

// Turns to the next coarser grid.
void next() {
    to += size.x * size.y;
    size = halved(size);
}

void store(ivec2 cell, vec4 equation) {
    if (all(lessThan(cell, size))) coarser[to + cell.y * size.x + cell.x] = equation;
}

void main() {
    int index = int(gl_LocalInvocationIndex);
    ivec2 tile = ivec2(gl_WorkGroupID.xy), cell = SIDE * tile + ivec2(index % SIDE, index / SIDE);
    vec4 quarters[4];
    [[unroll]] for (int n = 0; n < 4; n++)
        quarters[n] = coarse_equation(first, ivec2(width, height), 2 * cell + ivec2(n & 1, n >> 1));
    vec4 sum = sum_of(quarters[0], quarters[1], quarters[2], quarters[3]);
    to = first;
    size = ivec2(width, height);
    next();
    [[unroll]] for (int n = 0; n < 4; n++) store(2 * cell + ivec2(n & 1, n >> 1), quarters[n]);
    next();
    if (grids > 1) store(cell, sum);
    [[unroll]] for (int grid = 3; grid <= GRIDS; grid++) {
        // The first invocations, row by row, take four cells each.
        const int side = SIDE >> grid - 2;
        sums[index] = sum;
        barrier();
        next();
        int x = index % side, y = index / side, from = 2 * (2 * side * y + x);
        if (index < side * side) {
            sum = sum_of(sums[from], sums[from + 1], sums[from + 2 * side], sums[from + 2 * side + 1]);
            if (grid <= grids) store(side * tile + ivec2(x, y), sum);
        }
        barrier();
    }
}
