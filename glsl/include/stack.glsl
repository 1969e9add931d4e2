// The stack of uniformly blurred images: one layer of spline coefficients a node, or two. Twin: src/stages/stack.rs.

#include "spline.glsl"

// Of any kernel but a Gaussian: layers 2k and 2k + 1 are node k and its slope, and the kernel may have a mean.
layout(constant_id = 2) const bool ANY_KERNEL = false;

struct Blurred {
    float value;
    float slope;     // by the variance
    vec2 gradient;
};

float node_variance(int k) {
    float sigma = k <= 3 ? 0.5 * float(k) : 1.5 * pow(4.0 / 3.0, float(k - 3));
    return sigma * sigma;
}

int node_below(float v, int count) {
    float sigma = sqrt(v);
    float k = sigma < 1.5 ? floor(2.0 * sigma) : 3.0 + floor(log(sigma / 1.5) / log(4.0 / 3.0));
    return min(int(k), count - 2);
}

// Cubic Hermite between two nodes with slopes m and n.
Blurred between(int k, float v, Jet p, Jet q, float m, float n) {
    float v0 = node_variance(k);
    float h = node_variance(k + 1) - v0;
    float t = (v - v0) / h;
    bool beyond = t > 1.0;           // of the top node: held there
    t = min(t, 1.0);
    m *= h;
    n *= h;
    float rise = q.value - p.value;
    float value = p.value + (3.0 - 2.0 * t) * t * t * rise + ((t - 2.0) * t + 1.0) * t * m + (t - 1.0) * t * t * n;
    float slope = (6.0 * (t - t * t) * rise + ((3.0 * t - 4.0) * t + 1.0) * m + (3.0 * t - 2.0) * t * n) / h;
    return Blurred(value, beyond ? 0.0 : slope, mix(p.gradient, q.gradient, t));
}

Blurred stack_at(int image, int nodes, ivec2 size, float v, ivec2 i, vec2 f) {
    int k = node_below(v, nodes);
    if (ANY_KERNEL)
        return between(k, v, spline_at(image, 2 * k, size, i, f), spline_at(image, 2 * k + 2, size, i, f),
                       spline_at(image, 2 * k + 1, size, i, f).value, spline_at(image, 2 * k + 3, size, i, f).value);
    Jet p = spline_at(image, k, size, i, f), q = spline_at(image, k + 1, size, i, f);
    return between(k, v, p, q, 0.5 * p.laplacian, 0.5 * q.laplacian);
}

// On pixel i itself; of a Gaussian's stack alone.
Blurred stack_on(int image, int nodes, ivec2 size, float v, ivec2 i) {
    int k = node_below(v, nodes);
    Jet p = spline_on(image, k, size, i), q = spline_on(image, k + 1, size, i);
    return between(k, v, p, q, 0.5 * p.laplacian, 0.5 * q.laplacian);
}
