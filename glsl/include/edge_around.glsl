// Sums over the cells around the cell of a workgroup: NUMBERS sums over the cells within AROUND, an invocation for each
// cell.

const int SIDE_AROUND = 2 * AROUND + 1, NEIGHBOURS = SIDE_AROUND * SIDE_AROUND;

// The terms of each cell; then their sums over rows of cells.
shared float terms[NEIGHBOURS][NUMBERS], rows[SIDE_AROUND][NUMBERS];

// The cell of an invocation, and whether it is one of the image's.
ivec2 cell_around(ivec2 cell, int lane) { return cell + ivec2(lane % SIDE_AROUND, lane / SIDE_AROUND) - AROUND; }

bool is_inside(ivec2 cell) {
    return all(greaterThanEqual(cell, ivec2(0))) && all(lessThan(cell, ivec2(width, height) / CELL));
}

// Adds the terms that the invocations have written.
void add_terms(int lane) {
    barrier();
    int row = lane / NUMBERS, number = lane % NUMBERS;
    if (row < SIDE_AROUND) {
        float sum = 0.0;
        for (int i = 0; i < SIDE_AROUND; i++) sum += terms[SIDE_AROUND * row + i][number];
        rows[row][number] = sum;
    }
    barrier();
}

// A sum, after that.
float sum_of(int number) {
    float sum = 0.0;
    for (int row = 0; row < SIDE_AROUND; row++) sum += rows[row][number];
    return sum;
}
