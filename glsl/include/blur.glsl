// Î1 and Î2, both images as the kernel of variance V blurs them, and their derivatives by V. Twin: src/stages/blur.rs.

#include "stack.glsl"
#include "state.glsl"

// Beyond V = 0 a blurred image goes on linearly for half a px².
const float NEAR = 0.5;
// Below this |V| the kernel's mean moves linearly, so that its derivative stays finite.
const float LEAST_ROOT = 0.05;

struct Blur {
    ivec2 size;
    int nodes;                       // of the stacks, images 1 and 2
    vec2 mean;                       // of the kernel at V = 1
};

// Where the mean of the kernel lies at V, and its derivative by V, in I1's pixels. The kernel turns with the sensor that
// it blurs, which is I2's for V > 0.
mat2 mean_at(vec2 mean, Registration r, float v, float scale) {
    vec2 turn = vec2(1.0 + r.a, r.b) / scale;
    if (v > 0.0) mean = vec2(turn.x * mean.x + turn.y * mean.y, turn.x * mean.y - turn.y * mean.x);
    float root = sqrt(max(abs(v), LEAST_ROOT));
    return mat2(v / root * mean, (abs(v) > LEAST_ROOT ? 0.5 : 1.0) / root * mean);
}

// The image that is not blurred, going on through V = 0 with the slope it has there.
Blurred beyond(Jet jet, float slope, float v) {
    return Blurred(jet.value + slope * clamp(v, -NEAR, NEAR), abs(v) < NEAR ? slope : 0.0, jet.gradient);
}

// Of any kernel: the centred one, read where its mean takes it.
void blur_any(Blur b, Registration r, ivec2 x, float v, vec2 d, float scale, out Blurred b1, out Blurred b2) {
    mat2 mean = mean_at(b.mean, r, v, scale);
    mat2 linear = mat2(1.0 + r.a, r.b, -r.b, 1.0 + r.a);
    ivec2 i1, i2;
    vec2 f1, f2;
    place(x, -mean[0], b.size, i1, f1);
    place(x, d + linear * mean[0], b.size, i2, f2);
    if (v >= 0.0) {
        b1 = stack_at(1, b.nodes, b.size, v, i1, f1);
        float slope = -scale * scale * spline_at(2, 1, b.size, i2, f2).value;
        b2 = beyond(spline_at(2, 0, b.size, i2, f2), slope, v);
    } else {
        b1 = beyond(spline_at(1, 0, b.size, i1, f1), spline_at(1, 1, b.size, i1, f1).value, v);
        b2 = stack_at(2, b.nodes, b.size, -v * scale * scale, i2, f2);
        b2.slope *= -scale * scale;
    }
    b1.slope -= dot(b1.gradient, mean[1]);
    b2.slope += dot(b2.gradient, linear * mean[1]);
}

// Of a Gaussian: no mean, half the Laplacian for a slope, and I1 read on its pixels, where a spline takes nine
// coefficients instead of sixteen; the gradient of Î1 is then not needed. `i1` is I1 at x, `i2` the jet of I2 at x + d.
void blur_gaussian(Blur b, ivec2 x, float v, vec2 d, float scale, float i1, Jet i2, out Blurred b1, out Blurred b2) {
    if (v >= 0.0) {
        b1 = stack_on(1, b.nodes, b.size, v, x);
        b2 = beyond(i2, -0.5 * scale * scale * i2.laplacian, v);
    } else {
        b1 = beyond(Jet(i1, vec2(0.0), 0.0), 0.5 * spline_on(1, 0, b.size, x).laplacian, v);
        ivec2 i;
        vec2 f;
        place(x, d, b.size, i, f);
        b2 = stack_at(2, b.nodes, b.size, -v * scale * scale, i, f);
        b2.slope *= -scale * scale;
    }
}

// Î1 and Î2, the latter before gain and offset, both by V.
void blur(Blur b, Registration r, ivec2 x, float v, vec2 d, float scale, float i1, Jet i2, out Blurred b1,
          out Blurred b2) {
    if (ANY_KERNEL) blur_any(b, r, x, v, d, scale, b1, b2);
    else blur_gaussian(b, x, v, d, scale, i1, i2, b1, b2);
}
