#version 460
// The smallest grids of the cascade in one workgroup, in shared memory: sums the system up to the coarsest grid, solves
// it there, and relaxes on the way back. CPU reference: src/engine/stages/coarsest_grids_shared.rs.

#extension GL_EXT_control_flow_attributes : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer GridEquations { vec4 stored_equations[]; };
layout(binding = 1, std430) writeonly buffer GridSteps { float stored_steps[]; };
layout(push_constant) uniform Constants {
    int width, height;               // of the finest of these grids
    int first;                       // its first cell
    int grids;
    int sweeps, coarsest_sweeps;     // relaxation sweeps on each grid, and on the coarsest
    float over_relaxation;
};

const int TOTAL = 256;               // invocations
const int PER_COLOR = 2;             // cells of each color that an invocation relaxes
// The most cells of the finest grid, and of all: a coarser grid has a quarter, and more where sizes are odd.
const int CELLS = 1024, ALL_CELLS = 1536;

shared vec4 equations[ALL_CELLS];    // of all grids, the finest first
// dV of the grid that is being relaxed; then a place for each surplus invocation, which it alone reads.
shared float steps[CELLS + TOTAL];
#include "grid_equations.glsl"

int index;                           // of this invocation

ivec2 size_of(int grid) { return ivec2(width, height) + (1 << grid) - 1 >> grid; }

int cells(ivec2 size) { return size.x * size.y; }

void load() {
    [[unroll]] for (int n = 0; n < CELLS / TOTAL; n++) {
        int place = index + n * TOTAL;
        if (place < width * height) equations[place] = stored_equations[first + place];
    }
    barrier();
}

// Sums the system of a grid up to the next. `from` is its first cell.
void halve(int from, ivec2 fine) {
    ivec2 coarse = halved(fine);
    int to = from + cells(fine);
    [[unroll]] for (int n = 0; n < 2; n++) {
        int place = index + n * TOTAL;
        if (place < cells(coarse))
            equations[to + place] = coarse_equation(from, fine, ivec2(place % coarse.x, place / coarse.x));
    }
    barrier();
}

// The cells of this invocation, by color: their places, those of their neighbours, and their equations.
int place[2][PER_COLOR];
ivec4 neighbours[2][PER_COLOR];
vec4 links[2][PER_COLOR];
float right_side[2][PER_COLOR], dv[2][PER_COLOR];

// Relaxes the first `count` cells of this invocation of each color.
void relax(int sweeps, const int count) {
    for (int sweep = 0; sweep < sweeps; sweep++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            // Read before anything is written: the compiler does not know the two colors apart.
            vec4 around[PER_COLOR];
            [[unroll]] for (int n = 0; n < count; n++) {
                ivec4 at = neighbours[color][n];
                around[n] = vec4(steps[at.x], steps[at.y], steps[at.z], steps[at.w]);
            }
            [[unroll]] for (int n = 0; n < count; n++) {
                float target = right_side[color][n] + dot(links[color][n], around[n]);
                dv[color][n] = mix(dv[color][n], target, over_relaxation);
                steps[place[color][n]] = dv[color][n];
            }
            barrier();
        }
    }
}

// All sweeps on a grid, whose first cell is `from`, with at most `count` cells of each color for an invocation.
void relax_grid(int grid, int from, const int count) {
    bool is_coarsest = grid + 1 == grids;
    ivec2 size = size_of(grid);
    int columns = halved(size).x;
    [[unroll]] for (int n = 0; n < count; n++) {
        // Surplus invocations repeat the last cell.
        int at = min(index + n * TOTAL, columns * size.y - 1), y = at / columns;
        [[unroll]] for (int color = 0; color < 2; color++) {
            ivec2 x = ivec2(2 * (at - y * columns) + (y + color & 1), y);
            bool mine = index + n * TOTAL < columns * size.y && x.x < size.x;
            x.x = min(x.x, size.x - 1);
            int own = x.y * size.x + x.x;
            // Links across the border are zero. An invocation reads its own cell there, which no other one writes.
            bvec4 exists = bvec4(x.x + 1 < size.x, x.x > 0, x.y + 1 < size.y, x.y > 0);
            ivec4 around = mix(ivec4(own), own + ivec4(1, -1, size.x, -size.x), exists);
            vec4 cell = equations[from + own];
            float left = equations[from + around.y].z, above = equations[from + around.w].w;
            vec4 link = vec4(cell.z, exists.y ? left : 0.0, cell.w, exists.w ? above : 0.0);
            float over = 1.0 / max(cell.x + link.x + link.y + link.z + link.w, 1e-12);
            float coarse = steps[x.y / 2 * columns + x.x / 2];
            right_side[color][n] = over * cell.y;
            links[color][n] = over * link;
            neighbours[color][n] = mine ? around : ivec4(CELLS + index);
            place[color][n] = mine ? own : CELLS + index;
            dv[color][n] = is_coarsest ? 0.0 : coarse;
        }
    }
    barrier();
    [[unroll]] for (int n = 0; n < 2 * count; n++) steps[place[n & 1][n / 2]] = dv[n & 1][n / 2];
    barrier();
    relax(is_coarsest ? coarsest_sweeps : sweeps, count);
}

void main() {
    index = int(gl_LocalInvocationIndex);
    load();
    int from = 0;
    for (int grid = 0; grid + 1 < grids; grid++) {
        halve(from, size_of(grid));
        from += cells(size_of(grid));
    }
    for (int grid = grids - 1; grid >= 0; grid--) {
        ivec2 size = size_of(grid);
        if (halved(size).x * size.y <= TOTAL) relax_grid(grid, from, 1);
        else relax_grid(grid, from, PER_COLOR);
        if (grid > 0) from -= cells(size_of(grid - 1));
    }
    [[unroll]] for (int n = 0; n < CELLS / TOTAL; n++) {
        int place = index + n * TOTAL;
        if (place < width * height) stored_steps[first + place] = steps[place];
    }
}
