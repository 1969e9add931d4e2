// Samples of both images at a pixel, after blur.glsl. The includer declares `stacks`, the state, the specialization
// constant `WARPED` and the constants. CPU reference: `Samples` in src/engine/stages/blur.rs.

#include "coefficients.glsl"

// On a level whose pixels are `factor` wide; d is the displacement by T.
PairSample sample_pair(ivec2 x, vec2 d, Variances of, float factor) {
    Registration r = state.registration;
    ivec2 size = ivec2(width, height);
    Blur blur = Blur(size, nodes, vec2(mean[0], mean[1]));
    if (!WARPED) return blur_apart(blur, r, x, of, d, scale_of(r));
    vec2 shift = displacement(moved_since(state.warped, r), x, factor, vec2(centre[0], centre[1]));
    return blur_near(blur, of, shift, beside(x.x, size.x), beside(x.y, size.y));
}

// S, the residual.
float residual_of(PairSample both) {
    return both.first.value - (state.registration.gain * both.second.value + state.registration.offset);
}
