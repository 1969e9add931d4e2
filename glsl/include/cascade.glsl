// The part of the cascade that comes before a target, which is a grid or the level. A workgroup computes it for its
// tile of the target: first the small grids, in shared memory, then a tile of each grid in between. Other workgroups
// compute some of the same values. Included after the buffers `equations` and `steps` and the push constants.

#include "grid.glsl"

// The cascade from the coarsest grid on is computed here. Otherwise the target starts from `steps`.
layout(constant_id = 2) const bool JOINED = false;
// The target starts from its own dV, which an earlier dispatch has relaxed.
layout(constant_id = 3) const bool CONTINUES = false;

const int TOTAL = 256;               // invocations
const int PER_COLOR = 2;             // cells of each color that an invocation relaxes of a small grid
// The most cells of the finest small grid, and of all: a coarser grid has a quarter, and more where sizes are odd.
const int CELLS = 1024, ALL_CELLS = 1536;

#include "relaxation_tile.glsl"

// Equations of all small grids are in the memory of the tile, four numbers each, the finest grid first.
vec4 small_equation(int place) {
    return vec4(of_tile[4 * place], of_tile[4 * place + 1], of_tile[4 * place + 2], of_tile[4 * place + 3]);
}

void store_small(int place, vec4 equation) {
    [[unroll]] for (int n = 0; n < 4; n++) of_tile[4 * place + n] = equation[n];
}

// The n-th grid from the target, which is the first.
ivec2 size_of(int n) { return ivec2(width, height) + (1 << n) - 1 >> n; }

int cells(ivec2 size) { return size.x * size.y; }

// Sums the system of a small grid up to the next. `from` is its first cell.
void halve(int from, ivec2 fine) {
    ivec2 coarse = halved(fine);
    int to = from + cells(fine);
    [[unroll]] for (int n = 0; n < 2; n++) {
        int place = int(gl_LocalInvocationIndex) + n * TOTAL;
        if (place >= cells(coarse)) continue;
        vec4 of[4];
        [[unroll]] for (int k = 0; k < 4; k++) {
            ivec2 x = 2 * ivec2(place % coarse.x, place / coarse.x) + ivec2(k & 1, k >> 1);
            of[k] = all(lessThan(x, fine)) ? small_equation(from + x.y * fine.x + x.x) : vec4(0.0);
        }
        store_small(to + place, sum_of(of[0], of[1], of[2], of[3]));
    }
    barrier();
}

// Of this invocation's cells of a small grid, by color: their places, those of their neighbours, and their equations.
int places[2][PER_COLOR];
ivec4 neighbours[2][PER_COLOR];
vec4 small_links[2][PER_COLOR];
float small_side[2][PER_COLOR], small_dv[2][PER_COLOR];

// All sweeps on a small grid, whose first cell is `from`, with at most `count` cells of each color for an invocation.
void relax_small(ivec2 size, int from, bool is_coarsest, const int count) {
    int index = int(gl_LocalInvocationIndex), columns = halved(size).x;
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
            vec4 cell = small_equation(from + own);
            float left = of_tile[4 * (from + around.y) + 2], above = of_tile[4 * (from + around.w) + 3];
            vec4 link = vec4(cell.z, exists.y ? left : 0.0, cell.w, exists.w ? above : 0.0);
            float over = 1.0 / max(cell.x + link.x + link.y + link.z + link.w, 1e-12);
            small_side[color][n] = over * cell.y;
            small_links[color][n] = over * link;
            neighbours[color][n] = mine ? around : ivec4(CELLS + index);
            places[color][n] = mine ? own : CELLS + index;
            small_dv[color][n] = is_coarsest ? 0.0 : small_steps[x.y / 2 * columns + x.x / 2];
        }
    }
    barrier();
    [[unroll]] for (int n = 0; n < 2 * count; n++) small_steps[places[n & 1][n / 2]] = small_dv[n & 1][n / 2];
    barrier();
    int rounds = is_coarsest ? coarser.coarsest_sweeps : sweeps;
    for (int sweep = 0; sweep < rounds; sweep++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            // Read before anything is written: the compiler does not know the two colors apart.
            vec4 around[PER_COLOR];
            [[unroll]] for (int n = 0; n < count; n++) {
                ivec4 at = neighbours[color][n];
                around[n] = vec4(small_steps[at.x], small_steps[at.y], small_steps[at.z], small_steps[at.w]);
            }
            [[unroll]] for (int n = 0; n < count; n++) {
                float target = small_side[color][n] + dot(small_links[color][n], around[n]);
                small_dv[color][n] = mix(small_dv[color][n], target, over_relaxation);
                small_steps[places[color][n]] = small_dv[color][n];
            }
            barrier();
        }
    }
}

// dV of the finest small grid, in `small_steps`: sums the system up to the coarsest grid, and relaxes on the way back.
void solve_small_grids() {
    ivec2 size = size_of(coarser.grids + 1);
    [[unroll]] for (int n = 0; n < CELLS / TOTAL; n++) {
        int place = int(gl_LocalInvocationIndex) + n * TOTAL;
        if (place < cells(size)) store_small(place, equations[coarser.next + place]);
    }
    barrier();
    int from = 0;
    for (int n = 1; n < coarser.small_grids; n++) {
        halve(from, size);
        from += cells(size);
        size = halved(size);
    }
    for (int n = coarser.small_grids; n > 0; n--) {
        size = size_of(coarser.grids + n);
        if (halved(size).x * size.y <= TOTAL) relax_small(size, from, n == coarser.small_grids, 1);
        else relax_small(size, from, n == coarser.small_grids, PER_COLOR);
        if (n > 1) from -= cells(size_of(coarser.grids + n - 1));
    }
}

vec4 links[2][ROWS];                 // of a grid, divided by the diagonal, by color and row

// The equations of this invocation's cells of a grid. Beyond the border they only have to exist, since links across it
// are zero.
void load_grid(int first, ivec2 size) {
    int x = 2 * own.x, columns[2] = { clamp(x, 0, size.x - 1), clamp(x + 1, 0, size.x - 1) };
    vec4 here[2][ROWS];
    float left[ROWS], above[2];      // links
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        int line = first + clamp(own.y + row, 0, size.y - 1) * size.x;
        here[0][row] = equations[line + columns[0]];
        here[1][row] = equations[line + columns[1]];
        left[row] = equations[line + max(columns[0] - 1, 0)].z;
    }
    int line = first + clamp(own.y - 1, 0, size.y - 1) * size.x;
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

bool starts_from_small = true;
ivec2 corner_before;                 // of the tile of the coarser grid

// The corner of this workgroup's tile of the target, or of the n-th grid from it: even, and far enough outside for the
// halo. With up to four sweeps the interior of each grid's tile covers the next finer grid's tile.
ivec2 corner_of(int n) {
    ivec2 corner = interior() * ivec2(gl_WorkGroupID.xy) - 2 * halo;
    return n == 0 ? corner : (corner >> n & ~1) - (4 * halo + 2);
}

// dV of a cell of the coarser grid, which has this number of columns.
float coarse_step(ivec2 x, int columns) {
    if (!JOINED) return CONTINUES || coarser.next < 0 ? 0.0 : steps[coarser.next + x.y * columns + x.x];
    if (starts_from_small) return small_steps[x.y * columns + x.x];
    ivec2 at = x - corner_before;
    return of_tile[((at.x + at.y & 1) * SIDE + at.y) * COLUMNS + at.x / 2];
}

// dV before the first sweep: that of the coarser grid. Beyond the border it only has to exist, since weights across the
// border are zero.
void start(ivec2 size) {
    ivec2 coarse = halved(size);
    float values[ROWS / 2];
    [[unroll]] for (int row = 0; row < ROWS; row += 2)
        values[row / 2] = coarse_step(clamp(ivec2(own.x, (own.y + row) / 2), ivec2(0), coarse - 1), coarse.x);
    // The tile of the coarser grid is in the same memory.
    if (JOINED) barrier();
    start_from(values, size);
}

// All that comes before the target.
void relax_coarser_grids() {
    solve_small_grids();
    int first = coarser.next;
    for (int n = coarser.grids; n > 0; n--) {
        ivec2 size = size_of(n);
        first -= cells(size);
        place_tile(corner_of(n));
        load_grid(first, size);
        start(size);
        relax_tile();
        starts_from_small = false;
        corner_before = corner_of(n);
    }
}
