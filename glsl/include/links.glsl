// The links of a pixel to its neighbours by the smoothness. Included after the image `unknown` and the constants; SWEEP
// says whether the slope of the unknown counts as rough. CPU reference: src/engine/stages/links.rs.

const int REACH = 16;                // pixels on either side for the slope of V

float at(ivec2 x) { return imageLoad(unknown, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r; }

float inverse_gradient(float rise_x, float rise_y, float rate) {
    return inversesqrt(0.25 * rate * (rise_x * rise_x + rise_y * rise_y) + smoothness_eta * smoothness_eta);
}

// The rise of V from a pixel to the next, by its slopes over REACH pixels before and behind: their harmonic mean, 0
// where they differ in sign.
float slope(float far_before, float here, float next, float far_behind) {
    float before = here - far_before, behind = far_behind - next;
    return before * behind > 0.0 ? before * behind / (0.5 * float(REACH) * (before + behind)) : 0.0;
}

// To the right, left, lower and upper neighbour.
struct Links {
    vec4 weights;                    // 0 across the border
    vec4 rises;
    vec4 rough;                      // the rises less those by the slope
};

Links links_at(ivec2 x, float strength, float rate) {
    const ivec2 R = ivec2(1, 0), D = ivec2(0, 1);
    float here = at(x), right = at(x + R), left = at(x - R), below = at(x + D), above = at(x - D);
    float right_below = at(x + R + D), left_below = at(x - R + D);
    float right_above = at(x + R - D), left_above = at(x - R - D);
    vec4 phis = vec4(inverse_gradient(at(x + 2 * R) - here, right_below - right_above, rate),
                     inverse_gradient(here - at(x - 2 * R), left_below - left_above, rate),
                     inverse_gradient(right_below - left_below, at(x + 2 * D) - here, rate),
                     inverse_gradient(right_above - left_above, here - at(x - 2 * D), rate));
    bvec4 exists = bvec4(x.x + 1 < width, x.x > 0, x.y + 1 < height, x.y > 0);
    Links links;
    links.weights = mix(vec4(0.0), 0.5 * strength * (inverse_gradient(right - left, below - above, rate) + phis), exists);
    links.rises = vec4(right, left, below, above) - here;
    links.rough = links.rises;
    if (!SWEEP) {
        const ivec2 NEAR = ivec2(REACH, 0), FAR = ivec2(REACH + 1, 0);
        links.rough -= vec4(slope(at(x - NEAR), here, right, at(x + FAR)),
                            -slope(at(x - FAR), left, here, at(x + NEAR)),
                            slope(at(x - NEAR.yx), here, below, at(x + FAR.yx)),
                            -slope(at(x - FAR.yx), above, here, at(x + NEAR.yx)));
    }
    return links;
}
