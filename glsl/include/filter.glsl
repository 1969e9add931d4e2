// Weights of a filter, applied to adjacent values at once. Included after the weights `filters`, the number STRIDE of
// values from a result to the next, and, if filters may be longer than TAPS weights, ANY and BLOCK. CPU reference: weigh
// in src/engine/stages/separable.rs.

// Adjacent results per invocation: each weight and each value is loaded once for all of them.
const int SPAN = 8;
// The most weights of a filter that is not ANY. Others are zero.
const int TAPS = 19;
// Weights at once, and values for the results of an invocation.
const int COUNT = ANY ? BLOCK : TAPS, VALUES = COUNT + STRIDE * (SPAN - 1);

const float NONE[SPAN] = { 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 };

// Adds the values, times the weights from `first` on, to the sums.
void weigh(int first, float values[VALUES], inout float sums[SPAN]) {
    [[unroll]] for (int j = 0; j < SPAN; j++) {
        [[unroll]] for (int m = 0; m < COUNT; m++) sums[j] += filters[first + m / 4][m % 4] * values[STRIDE * j + m];
    }
}
