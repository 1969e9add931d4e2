// The state of a solve, and the displacement of a pixel by T. CPU reference: src/engine/stages/state.rs.

#include "law.glsl"
#include "shading.glsl"

const int MAX_LEVELS = 12;

struct LevelState {
    uint iterations;   // outer iterations
    float energy;      // of the latest iteration
    float valid;       // pixels
    uint warps;        // bit n: I2 was warped again before iteration 2^n
    uint settled;      // T and V are at rest: the level has no more iterations
    float moving;      // the share of the valid pixels below the limit of |V| that the latest step moved
};

// T p = (M p + t) / (1 + g·p), with p from the image centre in pixels of the full-size image. M minus the identity is
// stored, so that the identity is zeros.
struct Registration {
    float xx, xy, yx, yy;          // M - 1, by rows
    float tx, ty;
    float gx, gy;                  // 1/px
    float gain, offset;
};

// The parallax of a camera that moved: a place p from the image centre is displaced by (across + along p) V.
struct Parallax {
    float across_x, across_y;      // px per px²
    float along;                   // 1/px²
};

struct State {
    Registration registration; // T, gain and offset
    Parallax parallax; // displaces a pixel before T maps it
    float correlation; // of the low-passed images, when it was last measured
    uint degenerate;   // the last step had unknowns that the images do not determine
    float alpha;       // of the current level
    float kernel_shape; // 0: a Gaussian, 1: a disk
    uint becomes_disk; // the kernel of the current level was found to be a disk since its stacks were made
    float separation;  // of the two focus settings, p, px²; 0: the sharper photograph alone is blurred
    float spread;      // σ of noise in S, from adjacent pixels
    float scale_deviation; // of V, as a share of it
    Parallax parallax_deviation; // standard deviations
    float parallax_size; // the standard deviation of its size, as a share, where that is only the start's
    uint parallax_moves; // 1: its latest step was not at rest yet, so that the level may not settle
    float correlated;  // by how much the correlation of neighbouring residuals in a window counts, 0 to 1
    float variance;    // Σ b² / Σ D of the latest iteration
    uint moving;       // pixels that the latest step moved by more than a tenth of their standard deviation
    uint moving_far;   // and by more than half of it
    uint at_limit;     // pixels with data that it left at the limit of |V|
    uint clipped[2];   // clipped pixels of I1 and I2 that no mask excludes
    uint finished;     // workgroups of the current dispatch that have stored their sums
    float unit;        // of intensities, a power of two
    uint white;        // bits of the largest intensity of both photographs: those of positive floats have their order
    Registration warped;   // T when I2 was last warped onto I1's pixels
    float shading[TERMS];           // its coefficients
    float applied_shading[TERMS];   // the shading that I2 was last multiplied by
    LevelState levels[MAX_LEVELS];  // finest first
};

// The reciprocal of a power of two, exactly: devices round quotients.
float reciprocal(float power) { return intBitsToFloat((254 << 23) - floatBitsToInt(power)); }

// Beyond the horizon, where 1 + g·p falls to zero, T has no image. A pixel near or beyond it is mapped far outside.
const float HORIZON = 0.1;

// T x - x on a level whose pixels are `factor` wide. T x itself has steps of 2.4e-4 px at x = 4000 in single precision.
vec2 displacement_at(Registration r, vec2 x, float factor, vec2 centre) {
    vec2 p = x - centre;
    float depth = factor * (r.gx * p.x + r.gy * p.y);
    vec2 d = vec2(r.tx, r.ty) / factor + vec2(r.xx * p.x + r.xy * p.y, r.yx * p.x + r.yy * p.y);
    return (d - depth * p) / max(1.0 + depth, HORIZON);
}

vec2 displacement(Registration r, ivec2 x, float factor, vec2 centre) {
    return displacement_at(r, vec2(x), factor, centre);
}

bool is_some(Parallax p) {
    return p.across_x != 0.0 || p.across_y != 0.0 || p.along != 0.0;
}

// Its derivative by V, on a level whose pixels are `factor` wide.
vec2 parallax_by_v(Parallax p, vec2 x, float factor, vec2 centre) {
    return factor * (vec2(p.across_x, p.across_y) + p.along * factor * (x - centre));
}

// T (x + parallax) - x of a pixel with this V.
vec2 displacement_of(Registration r, Parallax p, vec2 x, float v, float factor, vec2 centre) {
    vec2 parallax = v * parallax_by_v(p, x, factor, centre);
    return parallax + displacement_at(r, x + parallax, factor, centre);
}

mat3 matrix(Registration r) {
    return mat3(1.0 + r.xx, r.yx, r.gx, r.xy, 1.0 + r.yy, r.gy, r.tx, r.ty, 1.0);
}

// T of a matrix minus the identity.
Registration from_excess(mat3 e) {
    float k = e[2][2], over = 1.0 / (1.0 + k);
    return Registration(over * (e[0][0] - k), over * e[1][0], over * e[0][1], over * (e[1][1] - k),
                        over * e[2][0], over * e[2][1], over * e[0][2], over * e[1][2], 0.0, 0.0);
}

// A matrix minus the identity.
mat3 excess(Registration r) {
    return mat3(r.xx, r.yx, r.gx, r.xy, r.yy, r.gy, r.tx, r.ty, 0.0);
}

// T after a small step. Both keep their digits.
Registration after(Registration r, Registration step) {
    Registration both = from_excess(excess(r) + matrix(r) * excess(step));
    both.gain = r.gain;
    both.offset = r.offset;
    return both;
}

// The displacement by the unknowns of T, in full-size pixels, with places divided by `unit` pixels of the level.
Registration step_of(float x[8], float factor, float unit) {
    vec4 linear = vec4(x[2], x[3], x[4], x[5]) / unit;
    vec2 g = vec2(x[6], x[7]) / (factor * unit * unit);
    return Registration(linear.x + linear.z, linear.w - linear.y, linear.y + linear.w, linear.x - linear.z,
                        factor * x[0], factor * x[1], g.x, g.y, 0.0, 0.0);
}

// The motion of T since an earlier T0: the registration whose displacement d has T x = T0 (x + d), in I1's pixels.
Registration moved_since(Registration before, Registration r) {
    return from_excess(inverse(matrix(before)) * (excess(r) - excess(before)));
}

// The Jacobian of T at the image centre: M - t gᵀ.
mat2 jacobian(Registration r) {
    return mat2(1.0 + r.xx - r.tx * r.gx, r.yx - r.ty * r.gx, r.xy - r.tx * r.gy, 1.0 + r.yy - r.ty * r.gy);
}

// s, the square root of T's area scale at the centre.
float scale_of(Registration r) {
    return sqrt(abs(determinant(jacobian(r))));
}

// T x as a pixel and a fraction, clamped to where a spline can be read.
void place(ivec2 x, vec2 d, ivec2 size, out ivec2 i, out vec2 f) {
    d = clamp(d, vec2(-1 - x), vec2(size - x));
    vec2 whole = floor(d);
    i = x + ivec2(whole);
    f = d - whole;
}

// Whether windows of three σ of the blurs of I1 and I2 lie inside both images: at x in I1, at x + d in I2, where pixels
// are `scale` times as wide.
bool inside(ivec2 x, vec2 d, ivec2 size, Variances of, float scale) {
    vec2 low = vec2(x), high = vec2(size - 1 - x);
    return all(greaterThanEqual(min(low, high), vec2(3.0 * sqrt(of.first))))
        && all(greaterThanEqual(min(low + d, high - d), vec2(3.0 * scale * sqrt(of.second))));
}

// Whether x lies inside I1, and x + d inside I2.
bool is_seen_by_both(ivec2 x, vec2 d, ivec2 size) {
    return inside(x, d, size, Variances(0.0, 0.0, 0.0, 0.0), 1.0);
}
