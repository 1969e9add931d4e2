// What the device knows of a solve, and where T puts a pixel. Twin: src/engine/stages/state.rs.

const int MAX_LEVELS = 12;

struct LevelState {
    uint iterations;
    uint converged;    // the latest iteration moved no corner by 0.01 px and the energy by less than 0.1 %
    float energy;      // of the latest iteration
    float valid;       // pixels
    uint warps;        // bit n: I2 was brought onto I1's pixels anew before iteration 2^n
    uint settled;      // the level does nothing any more
};

struct Registration {
    float a, b;        // s cos θ - 1, s sin θ
    float tx, ty;      // pixels of the full-size image
    float gain, offset;
};

struct State {
    Registration registration;
    float correlation; // of the two images at low pass, when it was last measured
    uint degenerate;   // the last step had unknowns that the images do not determine
    Registration warped;   // when I2 was last brought onto I1's pixels
    LevelState levels[MAX_LEVELS];
};

// T x - x on a level whose pixels are `factor` wide and whose centre is `centre`: T x itself has steps of 2.4e-4 px at
// x = 4000 in single precision.
vec2 displacement(Registration r, ivec2 x, float factor, vec2 centre) {
    vec2 p = vec2(x) - centre;
    return vec2(r.tx, r.ty) / factor + vec2(r.a * p.x - r.b * p.y, r.b * p.x + r.a * p.y);
}

// What T has done since an earlier T0: the registration whose displacement d has T x = T0 (x + d), in I1's pixels.
Registration moved_since(Registration before, Registration r) {
    vec2 w = vec2(1.0 + before.a, before.b);
    mat2 back = mat2(w.x, -w.y, w.y, w.x) / dot(w, w);
    vec2 ab = back * vec2(r.a - before.a, r.b - before.b), t = back * vec2(r.tx - before.tx, r.ty - before.ty);
    return Registration(ab.x, ab.y, t.x, t.y, 0.0, 0.0);
}

// s
float scale_of(Registration r) {
    return sqrt((1.0 + r.a) * (1.0 + r.a) + r.b * r.b);
}

// T x as a pixel and a fraction, not further out than a spline can be read.
void place(ivec2 x, vec2 d, ivec2 size, out ivec2 i, out vec2 f) {
    d = clamp(d, vec2(-1 - x), vec2(size - x));
    vec2 whole = floor(d);
    i = x + ivec2(whole);
    f = d - whole;
}

// Whether the window of three σ lies inside both images: at x in I1, at x + d in I2, where it is `scale` times as wide.
bool inside(ivec2 x, vec2 d, ivec2 size, float v, float scale) {
    float reach = 3.0 * sqrt(abs(v));
    vec2 low = vec2(x), high = vec2(size - 1 - x);
    return all(greaterThanEqual(min(low, high), vec2(reach)))
        && all(greaterThanEqual(min(low + d, high - d), vec2(reach * scale)));
}
