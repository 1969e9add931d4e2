// What a blur leaves of the noise of an image, so that V does not follow it. Twin: src/engine/stages/noise.rs.

struct Noise {
    float fall, reach;               // of the power under a blur, by V and by V²
    float sharpened;                 // rise of the power under a blur of less than nothing, by V²
};

// Power over that of the image as it is, and its derivative by V.
struct Power {
    float value, slope;
};

// What reading the image between pixels leaves.
float interpolated_power(vec2 d) {
    vec2 f = fract(d), between = 4.0 * f * (1.0 - f);
    vec2 left = 1.0 - 0.244 * between * between;
    return left.x * left.y;
}

// Under a blur of variance v >= 0 that comes on top of `before`.
Power blurred_power(Noise n, float v, float before) {
    float fall = n.fall / before;
    float value = inversesqrt(1.0 / (before * before) + (fall + n.reach * v) * v);
    return Power(value, -(0.5 * fall + n.reach * v) * value * value * value);
}

// Of the image that goes on through V = 0 with the slope it has there, v >= 0 beyond; held from `most` on.
Power beyond_power(Noise n, float v, float before, float most) {
    float rise = 0.5 * n.fall * before, bend = n.sharpened * rise * rise, u = min(v, most);
    return Power(before * (1.0 + (rise + bend * u) * u), v < most ? before * (rise + 2.0 * bend * u) : 0.0);
}
