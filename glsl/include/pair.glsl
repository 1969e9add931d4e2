// Samples of both images at a pixel of the full-size image. The includer declares `image1`, `stacks`, the state, the
// specialization constant `WARPED` and the constants. CPU reference: `sample_pair` in src/engine/stages/blur.rs.

#include "coefficients.glsl"

PairSample sample_pair(ivec2 x, vec2 d, float v) {
    Registration r = state.registration;
    ivec2 size = ivec2(width, height);
    vec2 centre = vec2(centre[0], centre[1]);
    Blur blur = Blur(size, nodes, vec2(mean[0], mean[1]));
    if (!WARPED) return blur_apart(blur, r, x, v, d, scale_of(r), imageLoad(image1, ivec3(x, 0)).r);
    ivec3 columns = ivec3(reflect_once(ivec2(x.x - 1, x.x), size.xx), reflect_once(ivec2(x.x + 1), size.xx).x);
    ivec3 lines = ivec3(reflect_once(ivec2(x.y - 1, x.y), size.yy), reflect_once(ivec2(x.y + 1), size.yy).x);
    vec2 shift = displacement(moved_since(state.warped, r), x, 1.0, centre);
    return blur_near(blur, v, shift, stencil(1, 0, columns, lines), stencil(2, 0, columns, lines), columns, lines);
}
