// The share by which a pixel counts: 1; 0 where it is masked or clipped in either image, or close to many such pixels.
// CPU reference: src/engine/stages/mask.rs.

// If false, all pixels count.
layout(constant_id = 4) const bool MASKED = false;

// The averaged mask of an image at pixel x.
float mask_at(int image, ivec2 x);

// 0 where a 25th of the surrounding pixels does not count: blur spreads what they show.
float from_share(float share) {
    return clamp(25.0 * share - 24.0, 0.0, 1.0);
}

// The share of pixel x of I1, which T displaces by d.
float counts(ivec2 x, vec2 d, ivec2 size) {
    if (!MASKED) return 1.0;
    vec2 y = clamp(d, vec2(-x), vec2(size - 1 - x)), f = fract(y);
    ivec2 low = x + ivec2(floor(y)), high = min(low + 1, size - 1);
    float above = mix(mask_at(2, low), mask_at(2, ivec2(high.x, low.y)), f.x);
    float below = mix(mask_at(2, ivec2(low.x, high.y)), mask_at(2, high), f.x);
    return from_share(mask_at(1, x)) * from_share(mix(above, below, f.y));
}
