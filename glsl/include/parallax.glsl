// The normal equations of a window for the step of T and of the parallax. CPU reference: src/engine/stages/parallax.rs.

#include "sums.glsl"

const int OF_T = 8;                  // unknowns of T, as of a homography
const int ALL = OF_T + 3;            // and the parallax across the axis, x and y, and along it
// The numbers of a window: the upper triangle of N, row by row; the gradient; the pixels that count, V times these, V²
// times these; the smoothness term; the evidence for the scale of V, and that of it by parallax.
const int GRADIENT_OF_ALL = ALL * (ALL + 1) / 2, PIXELS = GRADIENT_OF_ALL + ALL, OF_V = PIXELS + 1, SQUARE_OF_V = OF_V + 1;
const int ROUGHNESS_OF_V = SQUARE_OF_V + 1, EVIDENCE = ROUGHNESS_OF_V + 1, BY_PARALLAX = EVIDENCE + 1;
const int NUMBERS = BY_PARALLAX + 1;

int product_of(int i, int j) {
    int low = min(i, j);
    return low * ALL - low * (low - 1) / 2 + max(i, j) - low;
}
