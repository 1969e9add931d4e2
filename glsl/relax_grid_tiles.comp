#version 460
// Relaxation sweeps on a coarse grid of the cascade, on tiles with a halo; JOINED: also on all coarser ones. CPU
// reference: src/engine/stages/relax_grid_tiles.rs.

#extension GL_EXT_control_flow_attributes : require

#include "coarser.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer GridEquations { vec4 equations[]; };
layout(binding = 1, std430) readonly buffer CoarseSteps { float steps[]; };   // dV of the coarser grid, or its own
layout(binding = 2, std430) writeonly buffer GridSteps { float own_steps[]; }; // dV of the grid, in the same buffer
layout(push_constant) uniform Constants {
    int width, height;
    int first;                       // its first cell
    int to;                          // where its dV is stored
    int sweeps, halo;                // sweeps here, and those that the halo of a tile is for
    float over_relaxation;
    Coarser coarser;
};

#include "cascade.glsl"

vec4 weights_at(int color, int row) { return links[color][row]; }

void main() {
    ivec2 size = ivec2(width, height);
    if (JOINED) relax_coarser_grids();
    place_tile(corner_of(0));
    load_grid(first, size);
    start(size);
    relax_tile();
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        if (!is_written(row, size)) continue;
        int place = to + (own.y + row) * width + 2 * own.x;
        own_steps[place] = dv[row & 1][row];
        if (2 * own.x + 1 < width) own_steps[place + 1] = dv[1 - (row & 1)][row];
    }
}
