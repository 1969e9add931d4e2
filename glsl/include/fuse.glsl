// One channel of I1 and of J, which is I2 on I1's pixels with the exposure of I1. Channels are not in units, so the
// offset is multiplied by the unit. After spline.glsl and state.glsl, with the images and constants of fuse.comp.

float unit_of_coefficients() { return 1.0; }
float coefficient(int image, ivec3 place) {
    return imageLoad(spline2, place).r;
}

// I1 and J at a pixel with this V. Where I2 does not reach, both are I1.
vec2 photographs_at(ivec2 x, float v) {
    ivec2 size = ivec2(width, height), i;
    Registration r = state.registration;
    vec2 centre = vec2(centre[0], centre[1]), d = displacement_of(r, state.parallax, vec2(x), v, 1.0, centre), f;
    float first = imageLoad(channel1, ivec3(x, 0)).r;
    if (!is_seen_by_both(x, d, size)) return vec2(first);
    place(x, d, size, i, f);
    float shading = shading_at(state.applied_shading, (vec2(x) + d - centre) / centre);
    return vec2(first, r.gain * shading * spline_at(2, 0, size, i, f).value + state.unit * r.offset);
}
