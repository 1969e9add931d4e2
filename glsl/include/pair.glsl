// Samples of both images at a pixel, after blur.glsl. The includer declares `stacks`, the state, the specialization
// constant `WARPED` and the constants. CPU reference: `Samples` in src/engine/stages/blur.rs.

#include "coefficients.glsl"

// On a level whose pixels are `factor` wide; d is the pixel's displacement.
PairSample sample_pair(ivec2 x, vec2 d, Variances of, float factor) {
    Registration r = state.registration;
    ivec2 size = ivec2(width, height);
    Blur blur = Blur(size, nodes, vec2(mean[0], mean[1]));
    vec2 centre = vec2(centre[0], centre[1]);
    if (!WARPED || is_some(state.parallax)) {
        PairSample both = blur_apart(blur, r, x, of, d, scale_of(r));
        both.second.slope += dot(both.second.gradient, parallax_by_v(state.parallax, vec2(x), factor, centre));
        return both;
    }
    vec2 shift = displacement(moved_since(state.warped, r), x, factor, centre);
    return blur_near(blur, of, shift, beside(x.x, size.x), beside(x.y, size.y));
}

// S, the residual.
float residual_of(PairSample both) {
    return both.first.value - (state.registration.gain * both.second.value + state.registration.offset);
}
