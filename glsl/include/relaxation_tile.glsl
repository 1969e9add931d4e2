// Red-black relaxation sweeps on a tile and its halo, by a workgroup of 256 invocations (temporal blocking). Included
// after the buffer `steps` and the function `weights_at`.
//
// A halo is as wide as there are half-sweeps. Each half-sweep carries wrong values at its rim one pixel inwards, so
// that none reaches the interior.
//
// An invocation relaxes two columns of ROWS rows, in registers. Of the four neighbours of a pixel all but one are its
// own, except in its first and its last row. Only the others are read from shared memory.

const int SIDE = 64;                 // pixels of a tile with its halo, along x and y
const int COLUMNS = 32;              // of one color
const int ROWS = 8;                  // of an invocation

shared float of_tile[2][SIDE * COLUMNS];  // dV, by color

// Of this invocation: its column and its first row in the tile, and the same in the level or grid.
ivec2 in_tile, own;
// dV and right sides, by color and row.
float dv[2][ROWS], right_side[2][ROWS];

// The pixels of a tile without its halo, along x and y.
int interior(int sweeps) { return SIDE - 4 * sweeps; }

// Finds this invocation's pixels.
void place_tile(int sweeps) {
    int n = int(gl_LocalInvocationIndex);
    in_tile = ivec2(n % COLUMNS, n / COLUMNS * ROWS);
    ivec2 corner = interior(sweeps) * ivec2(gl_WorkGroupID.xy) - 2 * sweeps;
    own = ivec2(corner.x / 2, corner.y) + in_tile;
}

// Whether a row of this invocation is in the interior, and in an image of this size. Rows begin at even pixels.
bool is_written(int row, ivec2 size, int sweeps) {
    ivec2 x = in_tile + ivec2(0, row);
    return all(greaterThanEqual(x, ivec2(sweeps, 2 * sweeps))) &&
        all(lessThan(x, ivec2(COLUMNS - sweeps, SIDE - 2 * sweeps))) &&
        2 * own.x < size.x && own.y + row < size.y;
}

// dV before the first sweep: that of the coarser grid, whose first cell is `next`. Beyond the border it only has to
// exist, since weights across the border are zero.
void start(int next, ivec2 size) {
    ivec2 coarse = (size + 1) / 2;
    [[unroll]] for (int row = 0; row < ROWS; row += 2) {
        ivec2 x = clamp(ivec2(own.x, (own.y + row) / 2), ivec2(0), coarse - 1);
        float value = steps[next + x.y * coarse.x + x.x];
        [[unroll]] for (int n = 0; n < 4; n++) {
            int color = n & 1, odd = (n >> 1) + color & 1;
            // Nothing beyond an odd width.
            dv[color][row + (n >> 1)] = 2 * own.x + odd < size.x ? value : 0.0;
        }
    }
    [[unroll]] for (int n = 0; n < 2 * ROWS; n++)
        of_tile[n & 1][(in_tile.y + n / 2) * COLUMNS + in_tile.x] = dv[n & 1][n / 2];
    barrier();
}

void relax(int color, float over_relaxation) {
    int other = 1 - color;
    int left = max(in_tile.x - 1, 0), right = min(in_tile.x + 1, COLUMNS - 1);
    // Read before anything is written: the compiler does not know the two colors apart.
    float before = of_tile[other][max(in_tile.y - 1, 0) * COLUMNS + in_tile.x];
    float behind = of_tile[other][min(in_tile.y + ROWS, SIDE - 1) * COLUMNS + in_tile.x];
    float sides[ROWS];
    [[unroll]] for (int row = 0; row < ROWS; row++)
        sides[row] = of_tile[other][(in_tile.y + row) * COLUMNS + ((row + color & 1) == 1 ? right : left)];
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
        of_tile[color][(in_tile.y + row) * COLUMNS + in_tile.x] = dv[color][row];
    }
    barrier();
}

void relax_tile(int sweeps, float over_relaxation) {
    for (int sweep = 0; sweep < sweeps; sweep++) {
        relax(0, over_relaxation);
        relax(1, over_relaxation);
    }
}
