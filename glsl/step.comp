#version 460
// The registration step: sums the partial sums in a fixed order, solves N ζ = -g, updates T, gain and offset, and
// tests for convergence. One workgroup. Twin: src/engine/stages/step.rs.

#include "state.glsl"
#include "sums.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) buffer StateBuffer { State state; };
layout(binding = 2, std430) writeonly buffer Energies { float energies[]; };
layout(binding = 3, std430) writeonly buffer Arguments { uint arguments[]; };
layout(binding = 4, std430) readonly buffer AllArguments { uint all_arguments[]; };
layout(push_constant) uniform Constants {
    int rows;                        // of partial sums
    int level;
    int energy_place;                // of this level and iteration
    int argument_place, argument_count; // indirect arguments of this level
    int solve_transform, solve_photometric;
    int descend;                     // the gradient, instead of solving
    int may_settle;                  // α has its final value
    float still;                     // pixels of the level that no corner may move any more, for it to settle
    int warp_place, warp_count;      // indirect arguments of what brings I2 onto I1's pixels anew; none: not before the next
    float factor;                    // pixels of the full-size image a pixel of this level
    float scale_length;              // that scales a and b, pixels
    float half_width, half_height;   // from the centre to a corner, pixels
    float share;                     // of the step that is taken
};

// Pixels of the level that a corner may move before I2 is brought onto I1's pixels anew: following it by gradients looks
// like a change of V by the shift squared, 0.0004 px².
const float FOLLOWED = 0.02;

// Chains that add a share of the rows each, so that one workgroup is not one invocation.
const int CHAINS = 8;
shared float chains[CHAINS][SUMS];
shared float totals[SUMS];
shared bool settled, warps;

void add_up() {
    int n = int(gl_LocalInvocationIndex) % SUMS, chain = int(gl_LocalInvocationIndex) / SUMS;
    if (chain < CHAINS) {
        float sum = 0.0;
        for (int row = chain; row < rows; row += CHAINS) sum += partials[row * SUMS + n];
        chains[chain][n] = sum;
    }
    barrier();
    if (chain == 0) {
        float sum = 0.0;
        for (int c = 0; c < CHAINS; c++) sum += chains[c][n];
        totals[n] = sum;
    }
    barrier();
}

// Cholesky of N scaled to a unit diagonal, or a step down the gradient, over the sum of N's row; unknowns that are held or
// undetermined take no step.
void solve(out float x[6]) {
    float m[6][6], scale[6];                 // the lower triangle of N
    bool held[6];
    bool degenerate = !(totals[VALID] > 0.0);
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j <= i; j++) m[i][j] = totals[normal_place(j, i)];
    }
    for (int i = 0; i < 6; i++) {
        bool free = (i < 4 ? solve_transform : solve_photometric) == 1, unseen = !(m[i][i] > 1e-12 * totals[VALID]);
        degenerate = degenerate || free && unseen;
        held[i] = unseen || !free;
        scale[i] = held[i] ? 0.0 : inversesqrt(m[i][i]);
        x[i] = -totals[GRADIENT + i] * scale[i];
    }
    if (descend == 1) {
        for (int i = 0; i < 6; i++) {
            float row = 0.0;
            for (int j = 0; j < 6; j++) row += held[j] ? 0.0 : abs(i < j ? m[j][i] : m[i][j]);
            x[i] = held[i] ? 0.0 : x[i] / scale[i] / row;
        }
        state.degenerate = uint(degenerate);
        return;
    }
    for (int j = 0; j < 6; j++) {
        float pivot = 1.0;
        for (int k = 0; k < j; k++) pivot -= m[j][k] * m[j][k];
        // 1e-5: below it single precision has no digits of this unknown left.
        if (!(pivot > 1e-5)) { held[j] = true; degenerate = true; }
        m[j][j] = held[j] ? 1.0 : sqrt(pivot);
        for (int i = j + 1; i < 6; i++) {
            float sum = m[i][j] * scale[i] * scale[j];
            for (int k = 0; k < j; k++) sum -= m[i][k] * m[j][k];
            m[i][j] = held[j] ? 0.0 : sum / m[j][j];
        }
    }
    for (int i = 0; i < 6; i++) {
        for (int k = 0; k < i; k++) x[i] -= m[i][k] * x[k];
        x[i] = held[i] ? 0.0 : x[i] / m[i][i];
    }
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++) x[i] -= m[k][i] * x[k];
        x[i] = held[i] ? 0.0 : x[i] / m[i][i];
    }
    for (int i = 0; i < 6; i++) x[i] *= scale[i];
    state.degenerate = uint(degenerate);
}

// How far a corner moves, full-size pixels: by t and by (a, b) times its distance from the centre, level's pixels.
float corner_moves(float a, float b, vec2 t) {
    return length(t) + length(vec2(a, b)) * factor * length(vec2(half_width, half_height));
}

void step_once() {
    float x[6];
    solve(x);
    for (int i = 0; i < 6; i++) x[i] *= share;
    float a = x[0] / scale_length, b = x[1] / scale_length;
    float moved = corner_moves(a, b, factor * vec2(x[2], x[3]));
    state.registration.a += a;
    state.registration.b += b;
    state.registration.tx += factor * x[2];
    state.registration.ty += factor * x[3];
    state.registration.offset += x[5] - 0.5 * x[4];
    state.registration.gain += x[4];
    float energy = totals[ENERGY] / max(totals[VALID], 1.0);
    float before = state.levels[level].energy;
    float change = abs(energy - before);
    bool converged = may_settle == 1 && moved < 0.01 && change <= 1e-3 * before;
    state.levels[level].energy = energy;
    state.levels[level].valid = totals[VALID];
    state.levels[level].iterations += 1;
    energies[energy_place] = energy;
    state.levels[level].converged = uint(converged);
    // A level goes on a little after it has converged: the energy is flat before V and T are.
    settled = may_settle == 1 && moved < still * factor && change <= 0.1 * still * before;
    state.levels[level].settled = uint(settled);
    Registration since = moved_since(state.warped, state.registration);
    warps = warp_count > 0 && !settled && corner_moves(since.a, since.b, vec2(since.tx, since.ty)) > FOLLOWED * factor;
    if (warps) state.levels[level].warps |= 1u << findMSB(state.levels[level].iterations);
}

void main() {
    add_up();
    if (gl_LocalInvocationIndex == 0) step_once();
    barrier();
    int n = int(gl_LocalInvocationIndex), count = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int i = n; settled && i < argument_count; i += count) arguments[argument_place + i] = 0;
    for (int i = warp_place + n; i < warp_place + warp_count; i += count) arguments[i] = warps ? all_arguments[i] : 0;
}
