#version 460
// The fused blur-and-derivative pass: V, I1, I2, T to S1, S2, their derivatives, the weights, the linear system for dV, and
// the registration integrals. Equations 22 to 32 and 23. Twin: src/stages/linearise.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;

#include "blur.glsl"
#include "accumulate.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 2, r32f) uniform readonly image2DArray stack1;
layout(binding = 3, r32f) uniform readonly image2DArray stack2;
layout(binding = 4, r32f) uniform writeonly image2DArray right_sides;   // layer 0: red, layer 1: black
layout(binding = 5, rgba32f) uniform writeonly image2DArray weights;    // likewise; right, left, down, up
layout(binding = 6, r32f) uniform writeonly image2DArray change_red;    // dV
layout(binding = 7, r32f) uniform writeonly image2DArray change_black;
layout(binding = 8, std430) readonly buffer StateBuffer { State state; };
layout(binding = 9, std430) writeonly buffer Partials { float partials[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int rows;                        // pairs of pixels an invocation
    float factor;                    // pixels of the full-size image a pixel of this level
    float centre_x, centre_y;
    float length;                    // that scales a and b, pixels
    float alpha, final_alpha;
    float eta, smoothness_eta, epsilon;
    float elimination;               // share of Σa that damps the elimination of dV
    float mean_x, mean_y;            // of the kernel at V = 1
};

const float PI = 3.14159265358979;

float coefficient(int image, ivec3 place) {
    return image == 1 ? imageLoad(stack1, place).r : imageLoad(stack2, place).r;
}

float relative_blur_at(ivec2 x) {
    return imageLoad(relative_blur, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r;
}

// φ = 1/sqrt(|∇V|² + η²)
float inverse_gradient(float right, float left, float down, float up) {
    vec2 g = 0.5 * vec2(right - left, down - up);
    return inversesqrt(dot(g, g) + smoothness_eta * smoothness_eta);
}

struct Data {
    float s1, s2;                    // residuals
    float d1, d2;                    // their derivatives by V
    float w1, w2;                    // H ψ', (1-H) ψ'
    float energy;
    float value1, value2;            // I2 as S1 and as S2 see it, before gain and offset, with gradients
    vec2 gradient1, gradient2;
};

Data data_term(Registration r, ivec2 x, float v, vec2 d, float scale) {
    ivec2 size = ivec2(width, height), i;
    vec2 f;
    place(x, d, size, i, f);
    float i1 = imageLoad(image1, ivec3(x, 0)).r;
    Jet i2 = spline_at(2, 0, size, i, f);
    Blurred b1, b2;
    blur(Blur(size, nodes, vec2(mean_x, mean_y)), r, x, v, d, scale, i1, i2, b1, b2);
    float s1 = b1.value - (r.gain * i2.value + r.offset);
    float s2 = r.gain * b2.value + r.offset - i1;
    // Clamped, since a device's atan may overshoot and weights must not be negative.
    float heaviside = clamp(0.5 + atan(v / epsilon) / PI, 0.0, 1.0);
    float psi1 = sqrt(s1 * s1 + eta * eta), psi2 = sqrt(s2 * s2 + eta * eta);
    return Data(s1, s2, b1.slope, r.gain * b2.slope, heaviside / psi1, (1.0 - heaviside) / psi2,
                heaviside * psi1 + (1.0 - heaviside) * psi2, i2.value, b2.value, i2.gradient, b2.gradient);
}

struct Equation {
    float right_side;
    vec4 weights;                    // of the right, left, lower and upper neighbour
};

Equation linearise(Registration r, ivec2 x, inout Sums sums) {
    float scale = scale_of(r);
    ivec2 size = ivec2(width, height);
    float v = relative_blur_at(x);
    vec4 around = vec4(relative_blur_at(x + ivec2(1, 0)), relative_blur_at(x - ivec2(1, 0)),
                       relative_blur_at(x + ivec2(0, 1)), relative_blur_at(x - ivec2(0, 1)));
    vec4 corners = vec4(relative_blur_at(x + ivec2(1, 1)), relative_blur_at(x + ivec2(-1, 1)),
                        relative_blur_at(x + ivec2(1, -1)), relative_blur_at(x + ivec2(-1, -1)));
    float phi = inverse_gradient(around.x, around.y, around.z, around.w);
    vec4 phis = vec4(inverse_gradient(relative_blur_at(x + ivec2(2, 0)), v, corners.x, corners.z),
                     inverse_gradient(v, relative_blur_at(x - ivec2(2, 0)), corners.y, corners.w),
                     inverse_gradient(corners.x, corners.y, relative_blur_at(x + ivec2(0, 2)), v),
                     inverse_gradient(corners.z, corners.w, v, relative_blur_at(x - ivec2(0, 2))));
    bvec4 exists = bvec4(x.x + 1 < width, x.x > 0, x.y + 1 < height, x.y > 0);
    vec4 a = mix(vec4(0.0), 0.5 * alpha * (phi + phis), exists);
    float smoothness = a.x + a.y + a.z + a.w;
    float right_side = dot(a, around - v);

    vec2 p = vec2(x) - vec2(centre_x, centre_y);
    vec2 d = displacement(r, x, factor, vec2(centre_x, centre_y));
    float diagonal = 0.0;
    if (inside(x, d, size, v, scale)) {
        Data t = data_term(r, x, v, d, scale);
        diagonal = t.w1 * t.d1 * t.d1 + t.w2 * t.d2 * t.d2;
        right_side -= t.w1 * t.s1 * t.d1 + t.w2 * t.s2 * t.d2;
        float over = 1.0 / max(diagonal + elimination * smoothness, 1e-12);
        Jacobian j1 = jacobian(r.gain, t.value1, t.gradient1, p, length);      // of -S1
        Jacobian j2 = jacobian(r.gain, t.value2, t.gradient2, p, length);      // of S2
        float q1 = -t.w1 * t.d1, q2 = t.w2 * t.d2;
        Jacobian q = Jacobian(q1 * j1.transform + q2 * j2.transform, q1 * j1.photometric + q2 * j2.photometric);
        add_product(sums, t.w1, j1);
        add_product(sums, t.w2, j2);
        add_product(sums, -over, q);
        add_gradient(sums, -t.w1 * t.s1, j1);
        add_gradient(sums, t.w2 * t.s2, j2);
        add_gradient(sums, right_side * over, q);
        sums.photometric.w += t.energy + final_alpha / phi;
        sums.g_photometric.z += 1.0;
    }
    float over = 1.0 / max(diagonal + smoothness, 1e-12);
    return Equation(right_side * over, a * over);
}

// A red and a black pixel beside each other; dV starts from zero.
void store(ivec2 h, Equation red, Equation black) {
    imageStore(right_sides, ivec3(h, 0), vec4(red.right_side));
    imageStore(right_sides, ivec3(h, 1), vec4(black.right_side));
    imageStore(weights, ivec3(h, 0), red.weights);
    imageStore(weights, ivec3(h, 1), black.weights);
    imageStore(change_red, ivec3(h, 0), vec4(0.0));
    imageStore(change_black, ivec3(h, 0), vec4(0.0));
}

void main() {
    Sums sums = Sums(mat4(0.0), vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    Registration r = state.registration;
    Equation before;
    for (int n = 0; n < 2 * rows; n++) {
        ivec2 h = ivec2(gl_GlobalInvocationID.x,
                        (gl_WorkGroupID.y * rows + n / 2) * gl_WorkGroupSize.y + gl_LocalInvocationID.y);
        ivec2 x = ivec2(2 * h.x + n % 2, h.y);
        Equation equation = Equation(0.0, vec4(0.0));
        if (x.x < width && x.y < height) equation = linearise(r, x, sums);
        if (n % 2 == 1 && 2 * h.x < width && h.y < height) {
            if (h.y % 2 == 0) store(h, before, equation);
            else store(h, equation, before);
        }
        before = equation;
    }
    float sum = workgroup_sum(sums);
    uint n = gl_LocalInvocationIndex;
    if (n < SUMS) partials[(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * SUMS + n] = sum;
}
