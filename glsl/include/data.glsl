// The data term of a pixel, after pair.glsl and noise.glsl. The includer has the constants `noise` and `eta`. CPU
// reference: `Datum` in src/engine/stages/linearise.rs.

struct Data {
    float s;                         // residual
    float by_v;                      // its derivative by V, without the part of noise
    float weight;                    // ψ' times the share by which the pixel counts
    float psi;                       // ψ(S²)
    vec2 by_place;                   // of S, by T's displacement in I1's pixels
};

// Half the derivative by V of the logarithm of the noise of both images in S².
float noise_slope(Registration r, Variances of, vec2 d) {
    float square = r.gain * r.gain;
    Power n1 = blurred_power(noise, of.first, 1.0), n2 = blurred_power(noise, of.second, interpolated_power(d));
    return 0.5 * (n1.slope * of.first_by_v + square * n2.slope * of.second_by_v) / (n1.value + square * n2.value);
}

// `share` is the share by which the pixel counts, d its displacement.
Data data_term(Registration r, Variances of, PairSample both, float share, vec2 d) {
    float s = residual_of(both), psi = sqrt(s * s + eta * eta);
    float by_v = both.first.slope - r.gain * both.second.slope - noise_slope(r, of, d) * s;
    return Data(s, by_v, share / psi, psi, -r.gain * both.second.gradient);
}

const float BROAD = 4.0;

// The noise of the previous iteration, at least that of η.
float spread() { return max(state.spread, eta / BROAD); }

// The factor on the weight in T's step that broadens η to BROAD spreads.
float broadened(float psi) {
    float broad = BROAD * spread();
    return psi * inversesqrt(psi * psi - eta * eta + broad * broad);
}
