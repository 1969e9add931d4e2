// Adds up the rows of partial sums in a fixed order, by one workgroup. Needs `partials`.

#include "sums.glsl"

// Chains that add a share of the rows each, so that one workgroup is not one invocation: as many as fit into it.
const int MOST_CHAINS = 8;
shared float chains[MOST_CHAINS][SUMS];
shared float totals[SUMS];

void add_up(int rows) {
    int n = int(gl_LocalInvocationIndex) % SUMS, chain = int(gl_LocalInvocationIndex) / SUMS;
    int count = min(int(gl_WorkGroupSize.x * gl_WorkGroupSize.y) / SUMS, MOST_CHAINS);
    if (chain < count) {
        float sum = 0.0;
        for (int row = chain; row < rows; row += count) sum += partials[row * SUMS + n];
        chains[chain][n] = sum;
    }
    barrier();
    if (chain == 0) {
        float sum = 0.0;
        for (int c = 0; c < count; c++) sum += chains[c][n];
        totals[n] = sum;
    }
    barrier();
}
