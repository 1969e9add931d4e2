// Updates T: adds up the partial sums in a fixed order, solves N ζ = -g, and determines whether the level has settled.
// By one workgroup of 256 invocations. CPU reference: src/engine/stages/update_transform.rs.
//
// Bindings: `partials`, `energies`, `arguments`; `updated`, the state; `start_arguments`, those before the solve. The
// host may write the last word of these at any time: it is not zero once the solve is cancelled. Push constants:
// `t_step`; `factor`, pixels of the full-size image per pixel of this level. Functions: `rows_of_sums`, one for each
// workgroup of the pass that made the sums; `length_of_places`, L in pixels; `corner_place`, from the centre to a corner,
// pixels.

// Indirect arguments of a level; the last are those of the passes that warp I2 again.
const int WORDS = 225, WARP_WORDS = 144;

// I2 is warped again once a corner has moved by more, pixels of the level: following T by gradients changes V by the
// shift squared, 0.0004 px².
const float FOLLOWED = 0.02;

// I2 is warped again once the shading has changed by more: a thousandth of the contrast is 0.01 px² of V.
const float EVEN = 0.001;

// The most that the spread grows by in an iteration.
const float MOST_GROWTH = 8.0;

const float LEAST_ALPHA = 3.5e-4;
const float MOST_ALPHA = 10.0;
const float LEAST_STEEP = 0.007, MOST_STEEP = 0.1;   // px² per pixel

// Chains that add up a share of the rows each, so that many invocations work: as many as fit into the workgroup.
const int MOST_CHAINS = 8;
// Rows that a chain loads before it adds them, so that it waits for memory once.
const int AT_ONCE = 4;
shared float chains[MOST_CHAINS][SUMS];
shared float totals[SUMS];
// Sums of squares of the gradient by t, over the rows, each of a tile of pixels.
shared vec2 square_chains[MOST_CHAINS], squares;
// Pixels at the limit of |V| rest. Shares are of the others, or of at least this share of the valid pixels.
const float LEAST_FREE = 0.1;
// This many tiles or fewer are too few for a variance.
const float TOO_FEW = 12.0;

void add_up() {
    int n = int(gl_LocalInvocationIndex) % SUMS, chain = int(gl_LocalInvocationIndex) / SUMS;
    bool of_t = n >= GRADIENT && n < GRADIENT + 2;
    int count = min(int(gl_WorkGroupSize.x * gl_WorkGroupSize.y) / SUMS, MOST_CHAINS);
    if (chain < count) {
        float sum = 0.0, square = 0.0;
        for (int row = chain; row < rows_of_sums(); row += AT_ONCE * count) {
            float partial[AT_ONCE];
            [[unroll]] for (int k = 0; k < AT_ONCE; k++)
                partial[k] = row + k * count < rows_of_sums() ? partials[(row + k * count) * SUMS + n] : 0.0;
            [[unroll]] for (int k = 0; k < AT_ONCE; k++) {
                sum += partial[k];
                square += partial[k] * partial[k];
            }
        }
        chains[chain][n] = sum;
        if (of_t) square_chains[chain][n - GRADIENT] = square;
    }
    barrier();
    if (chain == 0) {
        float sum = 0.0, square = 0.0;
        for (int c = 0; c < count; c++) {
            sum += chains[c][n];
            if (of_t) square += square_chains[c][n - GRADIENT];
        }
        totals[n] = sum;
        if (of_t) squares[n - GRADIENT] = square;
    }
    barrier();
}

shared bool settled, warps, cancelled;

// The state before the step. Invocation 0 reads it first, since it would otherwise wait for the memory once for each
// member that it has written before.
Registration registration, warped;
float alpha, last_spread, shading_changed;
uint moving, moving_far, at_limit;
bool parallax_moves, displaces;
LevelState progress;

void load_state() {
    registration = updated.registration;
    warped = updated.warped;
    alpha = updated.alpha;
    last_spread = updated.spread;
    moving = updated.moving;
    moving_far = updated.moving_far;
    at_limit = updated.at_limit;
    parallax_moves = updated.parallax_moves != 0u;
    displaces = is_some(updated.parallax);
    progress = updated.levels[t_step.level];
    shading_changed = 0.0;
    for (int n = 0; n < TERMS; n++) shading_changed += abs(updated.shading[n] - updated.applied_shading[n]);
}

bool is_set(int flag) { return (t_step.flags & flag) != 0; }

float normal(int i, int j) {
    float sum = 0.0;
    for (int c = 0; c < 2; c++) {
        for (int d = 0; d < 2; d++) {
            int place = 3 * monomial(powers_of(i, c) + powers_of(j, d)) + c + d;
            sum += float(SIGNS[i][c] * SIGNS[j][d]) * totals[place];
        }
    }
    return sum;
}

float gradient(int i) {
    float sum = 0.0;
    for (int c = 0; c < 2; c++) sum += float(SIGNS[i][c]) * totals[GRADIENT + 2 * monomial(powers_of(i, c)) + c];
    return sum;
}

// The variance of the gradient by t, from its scatter over the tiles, over N.
float variance_by_tiles() {
    float tiles = float(rows_of_sums()), sum = 0.0;
    if (tiles <= TOO_FEW) return 0.0;
    for (int c = 0; c < 2; c++) sum += max(squares[c] - totals[GRADIENT + c] * totals[GRADIENT + c] / tiles, 0.0);
    return sum * tiles / (tiles - 1.0) / (normal(0, 0) + normal(1, 1));
}

// N scaled to a unit diagonal, by rows; -g in the last column.
shared float equations[8][9];
shared float solution[8];

// Gauss and Jordan's elimination of N, an element for each invocation, or a step down the gradient divided by the sum
// of N's row. Without exchanges of rows, as N is positive definite: pivots are those of Cholesky. Unknowns that are
// held or undetermined take no step. One invocation alone would take three times as long.
void solve() {
    int n = int(gl_LocalInvocationIndex), i = n / 9, j = n % 9;
    bool mine = i < UNKNOWNS && (j < UNKNOWNS || j == 8);
    if (mine) equations[i][j] = j == 8 ? -gradient(i) : normal(i, j);
    barrier();
    float most = 0.0, diagonal[UNKNOWNS];
    [[unroll]] for (int k = 0; k < UNKNOWNS; k++) {
        diagonal[k] = equations[k][k];
        most = max(most, diagonal[k]);
    }
    // 1e-7: stripes leave a gradient 3e-4 as steep as the others', by rounding.
    float least = max(1e-12 * totals[VALID], 1e-7 * most);
    bool degenerate = !(totals[VALID] > 0.0);
    uint held = 0;                   // a bit for each unknown
    [[unroll]] for (int k = 0; k < UNKNOWNS; k++) {
        bool unseen = !(diagonal[k] > least);
        degenerate = degenerate || k < t_step.unknowns && unseen;
        if (unseen || k >= t_step.unknowns) held |= 1u << k;
    }
    float own = 0.0, scale = 0.0;
    if (mine) {
        scale = inversesqrt(equations[i][i]);
        own = equations[i][j] * scale * (j == 8 ? 1.0 : inversesqrt(equations[j][j]));
    }
    if (is_set(DESCENDS)) {
        float row = 0.0;
        [[unroll]] for (int k = 0; k < UNKNOWNS; k++) row += (held >> k & 1) == 1 ? 0.0 : abs(equations[min(i, 7)][k]);
        own = own / scale / row;
    }
    barrier();
    if (mine) equations[i][j] = own;
    barrier();
    for (int k = 0; k < UNKNOWNS && !is_set(DESCENDS); k++) {
        float pivot = equations[k][k];
        // 1e-5: below it single precision has no digits of this unknown left.
        if ((held >> k & 1) == 0 && !(pivot > 1e-5)) { held |= 1u << k; degenerate = true; }
        if (mine && i != k && (held >> k & 1) == 0) own -= equations[i][k] * equations[k][j] / pivot;
        barrier();
        if (mine) equations[i][j] = own;
        barrier();
    }
    if (mine && j == 8) solution[i] = (held >> i & 1) == 1 ? 0.0 : is_set(DESCENDS) ? own : own / equations[i][i] * scale;
    if (n == 0) updated.degenerate = uint(degenerate);
    barrier();
}

// The most that a displacement moves a corner, full-size pixels: by t, by the larger singular value of the linear part
// times the distance of the corner from the centre, and by g times its square.
float corner_moves(Registration d) {
    float corner = factor * length(corner_place());
    float linear = 0.5 * (length(vec2(d.xx + d.yy, d.yx - d.xy)) + length(vec2(d.xx - d.yy, d.xy + d.yx)));
    return length(vec2(d.tx, d.ty)) + (linear + length(vec2(d.gx, d.gy)) * corner) * corner;
}

// α = 0.14 (mean √|b|)² / mean |∇V|. It changes only by more than a tenth, since each change takes iterations.
void find_alpha() {
    float count = max(totals[VALID], 1.0), root = totals[ROUGHNESS] / count, steep = totals[ROUGHNESS + 1] / count;
    float estimate = clamp(0.14 * root * root / clamp(steep, LEAST_STEEP, MOST_STEEP), LEAST_ALPHA, MOST_ALPHA);
    if (abs(log(estimate / alpha)) > 0.1) updated.alpha = estimate;
}

void find_spread() {
    float share = totals[SPREAD] / max(totals[VALID], 1.0);
    updated.spread = max(last_spread, t_step.least_spread) * min(share / max(1.0 - share, 1e-6), MOST_GROWTH);
}

void step_once() {
    float x[8];
    for (int i = 0; i < 8; i++) x[i] = i < UNKNOWNS ? solution[i] : 0.0;
    float decrease = 0.0;            // of the energy, twice
    for (int i = 0; i < UNKNOWNS; i++) {
        decrease -= x[i] * gradient(i);
        x[i] *= t_step.share;
    }
    Registration moves = step_of(x, factor, length_of_places());
    float moved = corner_moves(moves);
    registration = after(registration, moves);
    updated.registration = registration;
    float energy = totals[ENERGY] / max(totals[VALID], 1.0), before = progress.energy;
    float change = abs(energy - before);
    energies[t_step.energy_place] = energy;
    float free = max(max(totals[VALID] - float(at_limit), LEAST_FREE * totals[VALID]), 1.0);
    float share_moving = float(moving) / free;
    bool few = share_moving <= t_step.most_moving && float(moving_far) <= t_step.most_far * totals[VALID];
    updated.moving = 0;
    updated.moving_far = 0;
    updated.at_limit = 0;
    float variance = totals[VARIANCE] / max(totals[VARIANCE + 1], 1e-30);
    updated.variance = variance;
    bool rests = moved < t_step.still * factor || decrease < t_step.steady * variance ||
        decrease < t_step.steady_by_tiles * variance_by_tiles();
    settled = is_set(MAY_SETTLE) && rests && few && !parallax_moves && change <= t_step.flatness * before;
    // While T moves, its errors would count as noise.
    if (t_step.level == 0 && moved <= FOLLOWED * factor) find_spread();
    if (is_set(FINDS_ALPHA)) find_alpha();
    // With parallax I2 is not warped.
    bool follows = (displaces || corner_moves(moved_since(warped, registration)) <= FOLLOWED * factor)
        && shading_changed <= EVEN;
    warps = is_set(MAY_WARP) && !settled && !follows;
    uint iterations = progress.iterations + 1, warped_before = progress.warps;
    if (warps) warped_before |= 1u << findMSB(iterations);
    updated.levels[t_step.level] = LevelState(iterations, energy, totals[VALID], warped_before, uint(settled), share_moving);
}

// Ends this level and all finer ones.
void cancel() {
    for (int l = 0; l <= t_step.level; l++) updated.levels[l].settled = 1;
    settled = true;
    warps = false;
}

// With invocation 0 loading first, since the memory may be slow.
void update_transform() {
    if (gl_LocalInvocationIndex == 0) {
        cancelled = start_arguments[start_arguments.length() - 1] != 0;
        load_state();
    }
    add_up();
    solve();
    if (gl_LocalInvocationIndex == 0) {
        step_once();
        if (cancelled) cancel();
    }
    barrier();
    // A level has fewer words than the workgroup has invocations. A cancelled solve ends this level and all finer ones.
    int n = int(gl_LocalInvocationIndex), count = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    int first = WORDS * t_step.level, warp_first = first + WORDS - WARP_WORDS;
    if (settled && n < WORDS) arguments[first + n] = 0;
    if (is_set(MAY_WARP) && n < WARP_WORDS) arguments[warp_first + n] = warps ? start_arguments[warp_first + n] : 0;
    for (int i = n; cancelled && i < first; i += count) arguments[i] = 0;
}
