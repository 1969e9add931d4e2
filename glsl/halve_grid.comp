#version 460
// Sums the linear system for dV of a grid up to the next coarser grid of the cascade. CPU reference:
// src/engine/stages/halve_grid.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) buffer GridEquations { vec4 equations[]; };
#include "grid_equations.glsl"

layout(push_constant) uniform Constants {
    int width, height;               // of the finer grid
    int first, next;                 // first cell of the finer and of the coarser grid
};

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy), size = ivec2(width, height), coarse = halved(size);
    if (any(greaterThanEqual(cell, coarse))) return;
    equations[next + cell.y * coarse.x + cell.x] = coarse_equation(first, size, cell);
}
