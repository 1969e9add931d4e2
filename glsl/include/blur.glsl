// Î1 and Î2, both images blurred until they look alike, and their derivatives by V. CPU reference:
// src/engine/stages/blur.rs.

#include "stack.glsl"
#include "state.glsl"

// Below this variance the kernel's mean moves linearly, so that its derivative stays finite. At V = 0 both variances are
// 0.05, so that rounding does not choose the side.
const float LEAST_ROOT = 0.04;

struct Blur {
    ivec2 size;
    int nodes;                       // of the stacks, images 1 and 2
    vec2 mean;                       // of the kernel at variance 1
};

// Both images at a pixel, blurred, before gain and offset; slopes by V. Gradients are per pixel of I1.
struct PairSample {
    Blurred first, second;
};

// The mean of a kernel of this variance, and its derivative by the variance.
mat2 mean_at(vec2 mean, float variance) {
    float root = sqrt(max(variance, LEAST_ROOT));
    return mat2(variance / root * mean, (variance > LEAST_ROOT ? 0.5 : 1.0) / root * mean);
}

// For any kernel, with stacks of I1 and I2: each is read where T and the kernel's mean move the pixel.
PairSample blur_apart(Blur b, Registration r, ivec2 x, Variances of, vec2 d, float scale) {
    mat2 linear = jacobian(r);
    // The kernel rotates with the sensor of the blurred image, by the rotation nearest to T's Jacobian: that of I1's
    // blur is I2's.
    vec2 turn = normalize(vec2(linear[0][0] + linear[1][1], linear[0][1] - linear[1][0])), mean = b.mean;
    mat2 mean1 = mean_at(vec2(turn.x * mean.x + turn.y * mean.y, turn.x * mean.y - turn.y * mean.x), of.first);
    mat2 mean2 = mean_at(mean, of.second);
    ivec2 i1, i2;
    vec2 f1, f2;
    place(x, -mean1[0], b.size, i1, f1);
    place(x, d - linear * mean2[0], b.size, i2, f2);
    PairSample both;
    both.first = stack_at(1, b.nodes, b.size, of.first, i1, f1);
    both.second = stack_at(2, b.nodes, b.size, scale * scale * of.second, i2, f2);
    both.second.gradient = both.second.gradient * linear;
    both.first.slope = of.first_by_v * (both.first.slope - dot(both.first.gradient, mean1[1]));
    both.second.slope = of.second_by_v * (scale * scale * both.second.slope - dot(both.second.gradient, mean2[1]));
    return both;
}

// For kernels without a mean, with stacks of I1 and of I2 as warped onto I1's pixels. T has moved a pixel by `shift`
// since, so little that first order is exact enough.
PairSample blur_near(Blur b, Variances of, vec2 shift, ivec3 columns, ivec3 lines) {
    PairSample both;
    both.first = stack_on(1, b.nodes, of.first, columns, lines, vec2(0.0));
    both.second = stack_on(2, b.nodes, of.second, columns, lines, shift);
    both.first.slope *= of.first_by_v;
    both.second.slope *= of.second_by_v;
    return both;
}
