// The variances of the nodes of a blur stack, and the departure of a disk from a Gaussian. CPU reference:
// src/engine/stages/stack.rs.

float node_variance(int k) {
    float sigma = k <= 3 ? 0.5 * float(k) : 1.5 * pow(4.0 / 3.0, float(k - 3));
    return sigma * sigma;
}

// The departure of node k as a sum over the nodes k - 2 to k + 2, whose values are linear in it: node 1, 2, 3, 4, any
// later one, the last but one and the last.
const int DEPARTURE_NODES = 5, DEPARTURE_ROWS = 7;
const float DEPARTURES[DEPARTURE_NODES * DEPARTURE_ROWS] = float[](
    0.0, -0.0932, 0.0895, 0.0245, -0.0208,
    0.05, -0.5331, 0.891, -0.4994, 0.0916,
    0.1433, -1.5272, 2.8203, -1.7229, 0.2865,
    0.2179, -2.4981, 4.1224, -2.2063, 0.3641,
    0.3287, -2.6290, 4.1263, -2.1839, 0.3579,
    -0.4549, -0.0792, 0.9783, -0.4442, 0.0,
    -1.2787, 1.998, -0.7193, 0.0, 0.0);

// Where the row of node k > 0 of `count` begins.
int departure_row(int k, int count) {
    return DEPARTURE_NODES * (k + 2 < count ? min(k, 5) - 1 : DEPARTURE_ROWS + k - count);
}
