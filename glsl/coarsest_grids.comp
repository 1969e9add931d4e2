#version 460
// The small grids of the cascade in one workgroup: sums the system up to the coarsest grid, solves it there, and
// relaxes on the way back. There a dispatch takes longer than its work. CPU reference:
// src/engine/stages/coarsest_grids.rs.

#extension GL_EXT_control_flow_attributes : require

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

// The most cells of one color of the coarsest grid that are relaxed in shared memory, one by each invocation.
const int CELLS = 256;
shared float solved[2 * CELLS];

int total, index;                    // invocations, and this one's

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
    for (int n = index; n < coarse.x * coarse.y; n += total)
        equations[to + n] = coarse_equation(from, fine, ivec2(n % coarse.x, n / coarse.x));
}

// dV of a grid before its first sweep: that of the coarser grid, or zero.
void start(int grid) {
    ivec2 size = size_of(grid);
    int to = first_of(grid), from = to + size.x * size.y, coarse = halved(size).x;
    for (int n = index; n < size.x * size.y; n += total)
        steps[to + n] = grid + 1 == grids ? 0.0 : steps[from + n / size.x / 2 * coarse + n % size.x / 2];
}

// The n-th cell of a color. Those of a row beyond its width are outside.
ivec2 cell_of(int n, int color, ivec2 size) {
    int y = n / halved(size).x;
    return ivec2(2 * (n - y * halved(size).x) + (y + color & 1), y);
}

void relax(int grid, int color) {
    ivec2 size = size_of(grid);
    int from = first_of(grid), count = halved(size).x * size.y;
    for (int n = index; n < count; n += total) {
        ivec2 x = cell_of(n, color, size);
        if (x.x >= size.x) continue;
        int place = from + x.y * size.x + x.x;
        vec4 around = vec4(x.x + 1 < size.x ? steps[place + 1] : 0.0, x.x > 0 ? steps[place - 1] : 0.0,
                           x.y + 1 < size.y ? steps[place + size.x] : 0.0, x.y > 0 ? steps[place - size.x] : 0.0);
        vec4 links = links_at(place, x, size.x);
        steps[place] = relaxed(steps[place], equations[place].xy, links, around, over_relaxation);
    }
}

float solved_at(ivec2 x, ivec2 size) {
    return all(greaterThanEqual(x, ivec2(0))) && all(lessThan(x, size)) ? solved[x.y * size.x + x.x] : 0.0;
}

// All sweeps on the coarsest grid, where each color has at most one cell per invocation.
void relax_in_shared_memory(int grid) {
    ivec2 size = size_of(grid), x[2];
    int from = first_of(grid), count = halved(size).x * size.y;
    vec4 links[2];
    vec2 equation[2];
    bool mine[2];
    [[unroll]] for (int color = 0; color < 2; color++) {
        x[color] = cell_of(index, color, size);
        mine[color] = index < count && x[color].x < size.x;
        if (!mine[color]) continue;
        int place = from + x[color].y * size.x + x[color].x;
        links[color] = links_at(place, x[color], size.x);
        equation[color] = equations[place].xy;
        solved[place - from] = steps[place];
    }
    barrier();
    for (int sweep = 0; sweep < coarsest_sweeps; sweep++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            if (mine[color]) {
                ivec2 c = x[color];
                vec4 around = vec4(solved_at(c + ivec2(1, 0), size), solved_at(c - ivec2(1, 0), size),
                                   solved_at(c + ivec2(0, 1), size), solved_at(c - ivec2(0, 1), size));
                int place = c.y * size.x + c.x;
                solved[place] = relaxed(solved[place], equation[color], links[color], around, over_relaxation);
            }
            barrier();
        }
    }
    for (int n = index; n < size.x * size.y; n += total) steps[from + n] = solved[n];
    wait();
}

void main() {
    total = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    index = int(gl_LocalInvocationIndex);
    for (int grid = 0; grid + 1 < grids; grid++) {
        halve(grid);
        wait();
    }
    for (int grid = grids - 1; grid >= 0; grid--) {
        start(grid);
        wait();
        ivec2 size = size_of(grid);
        bool coarsest = grid + 1 == grids;
        if (coarsest && halved(size).x * size.y <= min(CELLS, total)) {
            relax_in_shared_memory(grid);
            continue;
        }
        int count = 2 * (coarsest ? coarsest_sweeps : sweeps);
        for (int n = 0; n < count; n++) {
            relax(grid, n & 1);
            wait();
        }
    }
}
