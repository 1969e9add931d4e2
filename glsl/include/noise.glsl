// The noise that remains in an image after a blur. CPU reference: src/engine/stages/noise.rs.

struct Noise {
    float fall, reach;               // of the power under a blur, by its variance and the square of it
};

// Power relative to that of the image itself, and its derivative by the variance.
struct Power {
    float value, slope;
};

// The power that remains after interpolation.
float interpolated_power(vec2 d) {
    vec2 f = fract(d), between = 4.0 * f * (1.0 - f);
    vec2 left = 1.0 - 0.244 * between * between;
    return left.x * left.y;
}

// Its derivatives by the displacement.
vec2 interpolated_slope(vec2 d) {
    vec2 f = fract(d), between = 4.0 * f * (1.0 - f);
    vec2 left = 1.0 - 0.244 * between * between;
    return -(2.0 * 0.244 * between * 4.0 * (1.0 - 2.0 * f)) * left.yx;
}

// The power after a blur of variance v >= 0 of an image whose power is `before`.
Power blurred_power(Noise n, float v, float before) {
    float fall = n.fall / before;
    float value = inversesqrt(1.0 / (before * before) + (fall + n.reach * v) * v);
    return Power(value, -(0.5 * fall + n.reach * v) * value * value * value);
}

// The derivative of that power, `value`, by that before the blur.
float by_before(Noise n, float v, float before, float value) {
    return value * value * value * (1.0 / (before * before) + 0.5 * n.fall / before * v) / before;
}
