// Blur stacks: uniformly blurred images, with one or two layers of spline coefficients per node. CPU reference:
// src/engine/stages/stack.rs.

#include "spline.glsl"
#include "nodes.glsl"

// Any kernel but a Gaussian: layers 2k and 2k + 1 are node k and its slope, and the kernel may have a mean.
layout(constant_id = 2) const bool ANY_KERNEL = false;

struct Blurred {
    float value;
    float slope;     // derivative by the variance
    vec2 gradient;
};

int node_below(float v, int count) {
    float sigma = sqrt(v);
    float k = sigma < 1.5 ? floor(2.0 * sigma) : 3.0 + floor(log(sigma / 1.5) / log(4.0 / 3.0));
    return min(int(k), count - 2);
}

// Cubic Hermite interpolation between two nodes.
Blurred between(int k, float v, Blurred p, Blurred q) {
    float v0 = node_variance(k);
    float h = node_variance(k + 1) - v0;
    float t = (v - v0) / h;
    bool beyond = t > 1.0;           // the last node, where the value is constant
    t = min(t, 1.0);
    float m = h * p.slope, n = h * q.slope;
    float rise = q.value - p.value;
    float value = p.value + (3.0 - 2.0 * t) * t * t * rise + ((t - 2.0) * t + 1.0) * t * m + (t - 1.0) * t * t * n;
    float slope = (6.0 * (t - t * t) * rise + ((3.0 * t - 4.0) * t + 1.0) * m + (3.0 * t - 2.0) * t * n) / h;
    return Blurred(value, beyond ? 0.0 : slope, mix(p.gradient, q.gradient, t));
}

// Node k at pixel i plus a fraction f.
Blurred node_at(int image, int k, ivec2 size, ivec2 i, vec2 f) {
    Jet jet = spline_at(image, ANY_KERNEL ? 2 * k : k, size, i, f);
    float slope = ANY_KERNEL ? spline_at(image, 2 * k + 1, size, i, f).value : 0.5 * jet.laplacian;
    return Blurred(jet.value, slope, jet.gradient);
}

Blurred stack_at(int image, int nodes, ivec2 size, float v, ivec2 i, vec2 f) {
    int k = node_below(v, nodes);
    return between(k, v, node_at(image, k, size, i, f), node_at(image, k + 1, size, i, f));
}

// A Gaussian's node k at a small shift from the pixel.
Blurred node_on(int image, int k, ivec3 columns, ivec3 lines, vec2 shift) {
    Jet jet = spline_near(stencil(image, k, columns, lines), shift);
    return Blurred(jet.value, 0.5 * jet.laplacian, jet.gradient);
}

Blurred stack_on(int image, int nodes, float v, ivec3 columns, ivec3 lines, vec2 shift) {
    int k = node_below(v, nodes);
    return between(k, v, node_on(image, k, columns, lines, shift), node_on(image, k + 1, columns, lines, shift));
}
