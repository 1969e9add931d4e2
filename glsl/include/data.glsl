// The data term of a pixel, after pair.glsl and noise.glsl. The includer has the constants `noise` and `eta`. CPU
// reference: `Datum` in src/engine/stages/linearise.rs.

struct Data {
    float s;                         // residual
    float by_v;                      // its derivative by V, without the part of noise
    float weight;                    // ψ' times the share by which the pixel counts
    float psi;                       // ψ(S²)
    vec2 by_place;                   // of S, by T's displacement in I1's pixels; with parallax also without that part
};

// Half the derivatives of the logarithm of the noise of both images in S², by V and by that of I2 between pixels.
vec2 noise_slopes(Registration r, Variances of, vec2 d) {
    float square = r.gain * r.gain, between = interpolated_power(d);
    Power n1 = blurred_power(noise, of.first, 1.0), n2 = blurred_power(noise, of.second, between);
    float slope = n1.slope * of.first_by_v + square * n2.slope * of.second_by_v;
    float by_between = square * by_before(noise, of.second, between, n2.value);
    return 0.5 * vec2(slope, by_between) / (n1.value + square * n2.value);
}

// `share` is the share by which the pixel x counts, d its displacement.
Data data_term(Registration r, Variances of, PairSample both, float share, vec2 d, ivec2 x) {
    float s = residual_of(both), psi = sqrt(s * s + eta * eta);
    vec2 slopes = noise_slopes(r, of, d), by_place = -r.gain * both.second.gradient;
    float by_v = both.first.slope - r.gain * both.second.slope - slopes.x * s;
    if (is_some(state.parallax)) {
        vec2 of_noise = slopes.y * s * interpolated_slope(d);
        by_place -= of_noise;
        by_v -= dot(of_noise, parallax_by_v(state.parallax, vec2(x), factor, vec2(centre[0], centre[1])));
    }
    return Data(s, by_v, share / psi, psi, by_place);
}

const float BROAD = 4.0;

// The noise of the previous iteration, at least that of η.
float spread() { return max(state.spread, eta / BROAD); }

// The factor on the weight in T's step that broadens η to BROAD spreads.
float broadened(float psi) {
    float broad = BROAD * spread();
    return psi * inversesqrt(psi * psi - eta * eta + broad * broad);
}
