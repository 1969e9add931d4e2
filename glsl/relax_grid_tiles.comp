#version 460
// All relaxation sweeps on a coarse grid of the cascade, on tiles with a halo. CPU reference:
// src/engine/stages/relax_grid_tiles.rs.

#extension GL_EXT_control_flow_attributes : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer GridEquations { vec4 equations[]; };
layout(binding = 1, std430) readonly buffer CoarseSteps { float steps[]; };   // dV of the coarser grid
layout(binding = 2, std430) writeonly buffer GridSteps { float own_steps[]; }; // dV of the grid, in the same buffer
layout(push_constant) uniform Constants {
    int width, height;
    int first, next;                 // first cell of the grid and of the next coarser one
    int sweeps;
    float over_relaxation;
};

vec4 links[2][8];                    // divided by the diagonal, by color and row

vec4 weights_at(int color, int row) { return links[color][row]; }

#include "relaxation_tile.glsl"

// The equations of this invocation's cells. Beyond the border they only have to exist, since links across it are zero.
void load() {
    int x = 2 * own.x, columns[2] = { clamp(x, 0, width - 1), clamp(x + 1, 0, width - 1) };
    vec4 here[2][ROWS];
    float left[ROWS], above[2];      // links
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        int line = first + clamp(own.y + row, 0, height - 1) * width;
        here[0][row] = equations[line + columns[0]];
        here[1][row] = equations[line + columns[1]];
        left[row] = equations[line + max(columns[0] - 1, 0)].z;
    }
    int line = first + clamp(own.y - 1, 0, height - 1) * width;
    above[0] = equations[line + columns[0]].w;
    above[1] = equations[line + columns[1]].w;
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        [[unroll]] for (int n = 0; n < 2; n++) {
            int color = row + n & 1;
            vec4 cell = here[n][row];
            float before = n == 1 ? here[0][row].z : x > 0 ? left[row] : 0.0;
            vec4 link = vec4(cell.z, before, cell.w, own.y + row > 0 ? above[n] : 0.0);
            float over = 1.0 / max(cell.x + link.x + link.y + link.z + link.w, 1e-12);
            right_side[color][row] = over * cell.y;
            links[color][row] = over * link;
            above[n] = cell.w;
        }
    }
}

void main() {
    ivec2 size = ivec2(width, height);
    place_tile(sweeps);
    load();
    start(next, size);
    relax_tile(sweeps, over_relaxation);
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        if (!is_written(row, size, sweeps)) continue;
        int place = first + (own.y + row) * width + 2 * own.x;
        own_steps[place] = dv[row & 1][row];
        if (2 * own.x + 1 < width) own_steps[place + 1] = dv[1 - (row & 1)][row];
    }
}
