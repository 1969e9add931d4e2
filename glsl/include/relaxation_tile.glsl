// Red-black relaxation sweeps on a tile and its halo, by a workgroup of 256 invocations (temporal blocking). Included
// by cascade.glsl, before the function `weights_at`.
//
// A halo is as wide as there are half-sweeps, or wider. Each half-sweep carries wrong values at its rim one pixel inwards, so
// that none reaches the interior.
//
// An invocation relaxes two columns of ROWS rows, in registers. Of the four neighbours of a pixel all but one are its
// own, except in its first and its last row. Only the others are read from shared memory.

const int SIDE = 64;                 // pixels of a tile with its halo, along x and y
const int COLUMNS = 32;              // of one color
const int ROWS = 8;                  // of an invocation

// dV, by color and row; before that, equations of small grids.
shared float of_tile[JOINED ? 4 * ALL_CELLS : 2 * SIDE * COLUMNS];
// dV of the small grid that is being relaxed; then a place for each surplus invocation, which it alone reads.
shared float small_steps[JOINED ? CELLS + TOTAL : 1];

// Of this invocation: its column and its first row in the tile, and the same in the level or grid.
ivec2 in_tile, own;
// dV and right sides, by color and row.
float dv[2][ROWS], right_side[2][ROWS];

// The pixels of a tile without its halo, along x and y.
int interior() { return SIDE - 4 * halo; }

// Finds this invocation's pixels of the tile with an even corner.
void place_tile(ivec2 corner) {
    int n = int(gl_LocalInvocationIndex);
    in_tile = ivec2(n % COLUMNS, n / COLUMNS * ROWS);
    own = ivec2(corner.x / 2, corner.y) + in_tile;
}

// Whether a row of this invocation is in the interior, and in an image of this size. Rows begin at even pixels.
bool is_written(int row, ivec2 size) {
    ivec2 x = in_tile + ivec2(0, row);
    return all(greaterThanEqual(x, ivec2(halo, 2 * halo))) &&
        all(lessThan(x, ivec2(COLUMNS - halo, SIDE - 2 * halo))) &&
        2 * own.x < size.x && own.y + row < size.y;
}

// The weights of the right, left, lower and upper neighbour.
vec4 weights_at(int color, int row);

int place_of(int color, int row) { return (color * SIDE + row) * COLUMNS + in_tile.x; }

// dV before the first sweep, of a cell of the coarser grid for each pair of rows; with CONTINUES of each pixel.
float started(int color, int row, float values[ROWS / 2], ivec2 size) {
    int x = 2 * own.x + (row + color & 1);
    if (x >= size.x) return 0.0;     // nothing beyond an odd width
    return CONTINUES ? steps[coarser.next + clamp(own.y + row, 0, size.y - 1) * size.x + max(x, 0)] : values[row / 2];
}

// Sets dV before the first sweep.
void start_from(float values[ROWS / 2], ivec2 size) {
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            dv[color][row] = started(color, row, values, size);
            of_tile[place_of(color, in_tile.y + row)] = dv[color][row];
        }
    }
    barrier();
}

void relax(int color) {
    int other = 1 - color;
    int left = in_tile.x > 0 ? -1 : 0, right = in_tile.x + 1 < COLUMNS ? 1 : 0;
    // Read before anything is written: the compiler does not know the two colors apart.
    float before = of_tile[place_of(other, max(in_tile.y - 1, 0))];
    float behind = of_tile[place_of(other, min(in_tile.y + ROWS, SIDE - 1))];
    float sides[ROWS];
    [[unroll]] for (int row = 0; row < ROWS; row++)
        sides[row] = of_tile[place_of(other, in_tile.y + row) + ((row + color & 1) == 1 ? right : left)];
    // Term by term, since those of a pixel wait for each other.
    float target[ROWS];
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        float above = row > 0 ? dv[other][row - 1] : before;
        target[row] = right_side[color][row] + weights_at(color, row).w * above;
    }
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        float below = row + 1 < ROWS ? dv[other][row + 1] : behind;
        target[row] += weights_at(color, row).z * below;
    }
    [[unroll]] for (int row = 0; row < ROWS; row++)
        target[row] += weights_at(color, row)[row + color & 1] * dv[other][row];
    [[unroll]] for (int row = 0; row < ROWS; row++)
        target[row] += weights_at(color, row)[1 - (row + color & 1)] * sides[row];
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        dv[color][row] = mix(dv[color][row], target[row], over_relaxation);
        of_tile[place_of(color, in_tile.y + row)] = dv[color][row];
    }
    barrier();
}

void relax_tile() {
    for (int sweep = 0; sweep < sweeps; sweep++) {
        relax(0);
        relax(1);
    }
}
