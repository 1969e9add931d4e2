#version 460
// The small grids of the cascade in one workgroup: sums the system up to the coarsest grid, solves it there, and relaxes
// on the way back. There a dispatch takes longer than its work. CPU reference: src/engine/stages/coarsest_grids.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) coherent buffer GridEquations { vec4 equations[]; };
layout(binding = 1, std430) coherent buffer GridSteps { float steps[]; };
#include "grid_equations.glsl"

layout(push_constant) uniform Constants {
    int width, height;               // of the finest of these grids
    int first;                       // its first cell
    int grids;
    int sweeps, coarsest_sweeps;     // relaxation sweeps on each grid, and on the coarsest
    float over_relaxation;
};

// Set once: SPIRV-Tools 2023.1 folds a second expression of the same specialization constants into invalid code.
ivec2 step;

// Other invocations read what was written before.
void wait() {
    memoryBarrierBuffer();
    barrier();
}

ivec2 size_of(int grid) {
    ivec2 size = ivec2(width, height);
    for (int n = 0; n < grid; n++) size = halved(size);
    return size;
}

int first_of(int grid) {
    ivec2 size = ivec2(width, height);
    int place = first;
    for (int n = 0; n < grid; n++) {
        place += size.x * size.y;
        size = halved(size);
    }
    return place;
}

void halve(int grid) {
    ivec2 fine = size_of(grid), coarse = halved(fine);
    int from = first_of(grid), to = first_of(grid + 1);
    for (int y = int(gl_LocalInvocationID.y); y < coarse.y; y += step.y) {
        for (int x = int(gl_LocalInvocationID.x); x < coarse.x; x += step.x)
            equations[to + y * coarse.x + x] = coarse_equation(from, fine, ivec2(x, y));
    }
}

// dV of a grid before its first sweep: that of the coarser grid, or zero.
void start(int grid) {
    ivec2 size = size_of(grid);
    int to = first_of(grid), from = to + size.x * size.y, coarse = halved(size).x;
    for (int y = int(gl_LocalInvocationID.y); y < size.y; y += step.y)
        for (int x = int(gl_LocalInvocationID.x); x < size.x; x += step.x)
            steps[to + y * size.x + x] = grid + 1 == grids ? 0.0 : steps[from + y / 2 * coarse + x / 2];
}

void relax(int grid, int color) {
    ivec2 size = size_of(grid);
    int from = first_of(grid);
    for (int y = int(gl_LocalInvocationID.y); y < size.y; y += step.y) {
        for (int x = 2 * int(gl_LocalInvocationID.x) + (y + color & 1); x < size.x; x += 2 * step.x) {
            int place = from + y * size.x + x;
            vec4 around = vec4(x + 1 < size.x ? steps[place + 1] : 0.0, x > 0 ? steps[place - 1] : 0.0,
                               y + 1 < size.y ? steps[place + size.x] : 0.0, y > 0 ? steps[place - size.x] : 0.0);
            vec4 links = links_at(place, ivec2(x, y), size.x);
            steps[place] = relaxed(steps[place], equations[place].xy, links, around, over_relaxation);
        }
    }
}

void main() {
    step = ivec2(gl_WorkGroupSize.xy);
    for (int grid = 0; grid + 1 < grids; grid++) {
        halve(grid);
        wait();
    }
    for (int grid = grids - 1; grid >= 0; grid--) {
        start(grid);
        wait();
        int count = 2 * (grid + 1 == grids ? coarsest_sweeps : sweeps);
        for (int n = 0; n < count; n++) {
            relax(grid, n & 1);
            wait();
        }
    }
}
