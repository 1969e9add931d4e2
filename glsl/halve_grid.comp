#version 460
// Sums the linear system for dV of a grid up to the next coarser grid of the cascade. CPU reference:
// src/engine/stages/halve_grid.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) buffer GridEquations { vec4 equations[]; };
layout(push_constant) uniform Constants {
    int width, height;               // of the finer grid
    int first, next;                 // first cell of the finer and of the coarser grid
};

#include "grid.glsl"

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy), size = ivec2(width, height), coarse = halved(size);
    if (any(greaterThanEqual(cell, coarse))) return;
    vec4 of[4];
    for (int n = 0; n < 4; n++) {
        ivec2 x = 2 * cell + ivec2(n & 1, n >> 1);
        of[n] = all(lessThan(x, size)) ? equations[first + x.y * size.x + x.x] : vec4(0.0);
    }
    equations[next + cell.y * coarse.x + cell.x] = sum_of(of[0], of[1], of[2], of[3]);
}
