#version 460
// Chooses the law and the kernel that leave the least of the residual in the windows. One workgroup. CPU reference:
// src/engine/stages/lens.rs.

#include "state.glsl"
#include "lens.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int windows;
    int level;                       // nothing changes once it has settled
    uint are_gaussian;               // the stacks have just been computed, for a Gaussian
};

// The least number of windows. With fewer, nothing changes.
const float LEAST_WINDOWS = 8.0;
// The largest separation, in means of |V|.
const float FARTHEST = 12.0;
// By how many standard errors over the windows a lens must leave less than the relative law, and a disk than a Gaussian.
const float CERTAIN = 2.0;
// By how much more a disk may leave that coarser levels have found.
const float FOUND = 0.1;
shared vec3 sums[MEAN];              // of the numbers: the mean and the variance of it; the mean of |V|

void main() {
    int n = int(gl_LocalInvocationIndex);
    if (n < MEAN) {
        vec3 sum = vec3(0.0);
        float whole = 0.0;
        for (int window = 0; window < windows; window++) {
            float mean = partials[NUMBERS * window + MEAN];
            if (mean < 0.0) continue;
            float number = partials[NUMBERS * window + n];
            sum += vec3(number, number * number, mean);
            whole += 1.0;
        }
        // The variance of the mean.
        vec3 means = sum / max(whole, 1.0);
        means.y = max(means.y - means.x * means.x, 0.0) / max(whole, 1.0);
        sums[n] = whole < LEAST_WINDOWS ? vec3(-1.0) : means;
    }
    barrier();
    if (n != 0) return;
    state.becomes_disk = 0u;
    bool was_disk = are_gaussian == 0u && state.kernel_shape != 0.0;
    float mean = sums[0].z, found = state.separation;
    if (mean < 0.0 || was_disk || state.levels[level].settled != 0u) return;
    // Residuals relative to that of the first lens.
    // One more than are used: with as many as the terms of the shading, the compiler takes the type of those in a buffer,
    // whose layout no variable may have (VUID-StandaloneSpirv-None-10684).
    float left[MOST_LENSES + 1];
    int count = lenses(found), best = 0;
    left[0] = 0.0;
    for (int lens = 1; lens < count; lens++) {
        left[lens] = left[lens - 1] + sums[1 + OF_LENS * (lens - 1) + CHAIN].x;
        if (separation_of(lens, found) <= FARTHEST * mean && left[lens] < left[best]) best = lens;
    }
    // The vertex of the parabola through the best one and its neighbours.
    float place = float(best);
    if (best > 0 && best + 1 < count) {
        float before = left[best - 1], behind = left[best + 1], bend = before - 2.0 * left[best] + behind;
        if (bend > 0.0) place += clamp(0.5 * (before - behind) / bend, -0.5, 0.5);
    }
    vec3 law = sums[1 + OF_LENS * best + LAW];
    bool is_lens = law.x > CERTAIN * sqrt(law.y);
    vec3 kernel = sums[is_lens ? 1 + OF_LENS * best + KERNEL : 0];
    bool is_disk = kernel.x > (state.kernel_shape != 0.0 ? -FOUND : CERTAIN * sqrt(kernel.y));
    float ratio = found > 0.0 ? RATIO : FIRST_RATIO;
    state.kernel_shape = is_disk ? 1.0 : 0.0;
    state.becomes_disk = is_disk ? 1u : 0u;
    state.separation = is_disk && is_lens ? separation_of(0, found) * pow(ratio, place) : 0.0;
}
