// V ← V + share clamp(dV) on a block of 2 x 2 pixels. A whole step may be kept, and the next one extrapolated from it.
// Included after the images `relative_blur`, `smoothed` (D, averaged over a window) and `kept` (layer KEPT: the
// sums of a whole step over blocks), the buffer `state`, and the constants. CPU reference: src/engine/stages/update.rs.

const int KEEP = 1, EXTRAPOLATE = 2, KEPT = 3;
// Bounds of the factor by which an extrapolated step is longer.
const float LEAST_FACTOR = 0.5, MOST_FACTOR = 2.0;

// A pixel moves if its step is more than the first share of its standard deviation, and far if more than the second.
const float STILL = 0.1, FAR = 0.5;
// Of the standard deviation: 1/(4π 4²), the window's effective pixels, and the square of its factor 1.8.
const float INDEPENDENT = 0.004973592, WIDER = 3.24;

bool moves(float change, float d, float share_of_deviation) {
    float step = share_of_deviation * share_of_deviation;
    return d * change * change > step * WIDER * INDEPENDENT * state.variance;
}

// Aitken: if steps change in proportion to what is left, the remaining distance is the step times this.
float factor(float change, float before) {
    return before == 0.0 ? 1.0 : max(1.0 / max(1.0 - change / before, 1.0 / MOST_FACTOR), LEAST_FACTOR);
}

// What the update of a block reads, pixels row by row; 0 beyond the border.
struct Block {
    float before[4], d[4];
    float kept;
};

Block load_block(ivec2 first) {
    Block block;
    ivec2 size = ivec2(width, height);
    // Reading a pixel that is not the block's own would race with the invocation that writes it.
    [[unroll]] for (int n = 0; n < 4; n++) {
        ivec3 x = ivec3(first + ivec2(n % 2, n / 2), 0);
        bool exists = all(lessThan(x.xy, size));
        block.before[n] = exists ? imageLoad(relative_blur, x).r : 0.0;
        block.d[n] = exists ? imageLoad(smoothed, x).r : 0.0;
    }
    bool extrapolates = extrapolation == EXTRAPOLATE && all(lessThan(first, size));
    block.kept = extrapolates ? imageLoad(kept, ivec3(first / 2, KEPT)).r : 0.0;
    return block;
}

// Updates a block by its changes, row by row, if it is `mine`. Returns the pixels that still move, those that move far,
// and those at the limit.
uvec3 update_block(ivec2 first, float change[4], Block block, bool mine) {
    bool exists[4];
    float sum = 0.0;
    [[unroll]] for (int n = 0; n < 4; n++) {
        exists[n] = mine && all(lessThan(first + ivec2(n % 2, n / 2), ivec2(width, height)));
        float most = max(largest_step, relative_step * abs(block.before[n]));
        change[n] = exists[n] ? clamp(change[n], -most, most) : 0.0;
        sum += change[n];
    }
    if (exists[0] && extrapolation == KEEP) imageStore(kept, ivec3(first / 2, KEPT), vec4(sum));
    float taken = extrapolation == EXTRAPOLATE ? share * factor(sum, block.kept) : share;
    uvec3 moving = uvec3(0);
    [[unroll]] for (int n = 0; n < 4; n++) {
        float before = block.before[n], d = block.d[n];
        float after = clamp(before + taken * change[n], -limit, limit);
        if (exists[n]) imageStore(relative_blur, ivec3(first + ivec2(n % 2, n / 2), 0), vec4(after));
        float whole = clamp(before + change[n], -limit, limit) - before;
        uvec3 counts = uvec3(moves(whole, d, STILL), moves(whole, d, FAR), d > 0.0 && abs(after) == limit);
        moving += exists[n] ? counts : uvec3(0);
    }
    return moving;
}

// Adds the counts of all invocations to the state.
void count(uvec3 moving) {
    uvec3 total = subgroupAdd(moving);
    if (!subgroupElect()) return;
    if (total.x > 0) atomicAdd(state.moving, total.x);
    if (total.y > 0) atomicAdd(state.moving_far, total.y);
    if (total.z > 0) atomicAdd(state.at_limit, total.z);
}
