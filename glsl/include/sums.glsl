// What the registration step sums over the valid pixels: the upper triangle of N between a L, b L, tx, ty, gain, offset,
// row by row; g; the energy; the valid pixels. Twin: src/engine/stages/sums.rs.
//
// Vectors and no array: software devices keep arrays in memory.

const int UNKNOWNS = 6;
const int SUMS = 32;
const int GRADIENT = 21;
const int ENERGY = 27;
const int VALID = 28;

struct Sums {
    vec4 n00, n04, n13, n23, n34, n55, g3, valid;   // by the first place of each
};

// Where N(i, j), i <= j, stands.
int normal_place(int i, int j) {
    return i * UNKNOWNS - i * (i - 1) / 2 + j - i;
}
