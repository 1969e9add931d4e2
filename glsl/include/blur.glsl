// Î1 and Î2, both images blurred by the kernel of variance V, and their derivatives by V. CPU reference:
// src/engine/stages/blur.rs.

#include "stack.glsl"
#include "state.glsl"

// Beyond V = 0 a blurred image is extrapolated linearly for this many px².
const float NEAR = 0.5;
// Below this |V| the kernel's mean moves linearly, so that its derivative stays finite.
const float LEAST_ROOT = 0.05;

struct Blur {
    ivec2 size;
    int nodes;                       // of the stacks, images 1 and 2
    vec2 mean;                       // of the kernel at V = 1
};

// Both images at a pixel: I1, J and its gradient before gain and offset, and both images blurred. Gradients are per
// pixel of I1.
struct PairSample {
    float i1;
    Blurred j;
    Blurred b1, b2;
};

// The mean of the kernel at V, and its derivative by V, in I1's pixels. The kernel rotates with the sensor of the
// blurred image, which is I2 for V > 0: by the rotation nearest to T's Jacobian.
mat2 mean_at(vec2 mean, mat2 linear, float v) {
    vec2 turn = normalize(vec2(linear[0][0] + linear[1][1], linear[0][1] - linear[1][0]));
    if (v > 0.0) mean = vec2(turn.x * mean.x + turn.y * mean.y, turn.x * mean.y - turn.y * mean.x);
    float root = sqrt(max(abs(v), LEAST_ROOT));
    return mat2(v / root * mean, (abs(v) > LEAST_ROOT ? 0.5 : 1.0) / root * mean);
}

// The image that is not blurred, extrapolated linearly through V = 0.
Blurred beyond(float value, vec2 gradient, float slope, float v) {
    return Blurred(value + slope * clamp(v, -NEAR, NEAR), abs(v) < NEAR ? slope : 0.0, gradient);
}

// For any kernel, with stacks of I1 and I2: I2 is read where T and the kernel's mean move the pixel.
PairSample blur_apart(Blur b, Registration r, ivec2 x, float v, vec2 d, float scale, float i1) {
    mat2 linear = jacobian(r), mean = mean_at(b.mean, linear, v);
    ivec2 i, i1_at, i2_at;
    vec2 f, f1, f2;
    place(x, d, b.size, i, f);
    place(x, -mean[0], b.size, i1_at, f1);
    place(x, d + linear * mean[0], b.size, i2_at, f2);
    Jet jet = spline_at(2, 0, b.size, i, f);
    PairSample both;
    both.i1 = i1;
    both.j = Blurred(jet.value, 0.0, jet.gradient * linear);
    if (v >= 0.0) {
        both.b1 = stack_at(1, b.nodes, b.size, v, i1_at, f1);
        Blurred node = node_at(2, 0, b.size, i2_at, f2);
        both.b2 = beyond(node.value, node.gradient, -scale * scale * node.slope, v);
    } else {
        Blurred node = node_at(1, 0, b.size, i1_at, f1);
        both.b1 = beyond(node.value, node.gradient, node.slope, v);
        both.b2 = stack_at(2, b.nodes, b.size, -v * scale * scale, i2_at, f2);
        both.b2.slope *= -scale * scale;
    }
    both.b1.slope -= dot(both.b1.gradient, mean[1]);
    both.b2.gradient = both.b2.gradient * linear;
    both.b2.slope += dot(both.b2.gradient, mean[1]);
    return both;
}

// For a Gaussian, with stacks of I1 and of I2 as warped onto I1's pixels. T has moved a pixel by `shift` since, so
// little that first order is exact enough. `i1` and `i2` are the coefficients around the pixel in the sharp layers.
PairSample blur_near(Blur b, float v, vec2 shift, Stencil i1, Stencil i2, ivec3 columns, ivec3 lines) {
    Jet sharp1 = spline_near(i1, vec2(0.0)), sharp2 = spline_near(i2, shift);
    bool first = v >= 0.0;
    Blurred blurred = stack_on(first ? 1 : 2, b.nodes, abs(v), columns, lines, first ? vec2(0.0) : shift);
    PairSample both;
    both.i1 = sharp1.value;
    both.j = Blurred(sharp2.value, 0.0, sharp2.gradient);
    if (first) {
        both.b1 = blurred;
        both.b2 = beyond(sharp2.value, sharp2.gradient, -0.5 * sharp2.laplacian, v);
    } else {
        both.b1 = beyond(sharp1.value, vec2(0.0), 0.5 * sharp1.laplacian, v);
        both.b2 = blurred;
        both.b2.slope = -blurred.slope;
    }
    return both;
}
