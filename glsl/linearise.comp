#version 460
// Computes D and b of each pixel's equation for dV, and the registration integrals, from V, I1, I2 and T. Equations 22
// to 32 and 23. CPU reference: src/engine/stages/linearise.rs.
//
// An invocation computes two adjacent columns and keeps the surrounding lines in registers: V, its inverse gradient and
// the sharp coefficients are loaded once per line instead of once per pixel.

#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a Gaussian.
layout(constant_id = 3) const bool WARPED = false;

#include "blur.glsl"
#include "accumulate.glsl"
#include "noise.glsl"
#include "mask.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 2, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of I2
layout(binding = 3, r32f) uniform writeonly image2DArray normal_equations; // D, b
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(binding = 5, std430) coherent buffer Partials { float partials[]; };
layout(binding = 6, r32f) uniform readonly image2DArray masks;          // of I1, of I2
layout(binding = 7, std430) buffer UpdatedBuffer { State updated; };     // the state, by the last workgroup
// What includes update_transform.glsl must not read `state` after it: a compiler may take it for other memory.
layout(binding = 8, std430) writeonly buffer Energies { float energies[]; };
layout(binding = 9, std430) writeonly buffer Arguments { uint arguments[]; };
layout(binding = 10, std430) readonly volatile buffer AllArguments { uint start_arguments[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int second_stack;                // its first layer
    int rows;                        // lines per invocation
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    float scale_length;              // L, the length that places are divided by, pixels
    float continuation;              // factor by which α is larger than its final value
    float eta, smoothness_eta, epsilon;
    float elimination;               // share of Σa that damps the elimination of dV
    float mean[2];                   // of the kernel at V = 1
    Noise noise;                     // of either image
    Step t_step;
};

const float PI = 3.14159265358979;
const float BROAD = 4.0;
const float BOUND = 0.612;

#include "coefficients.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

// A line of V: columns -2 to 3 from the left one of the two.
struct Line {
    float left;
    vec4 middle;
    float right;
};

// In registers: V of the lines -1 to 2 from the current one, φ of -1 to 1, columns -1 to 2.
struct Around {
    Line above, here, below, next;
    vec4 phi_above, phi, phi_below;
};

// The coefficients of a sharp image on lines -1 to 1, columns -1 to 2.
struct Sharp {
    vec4 above, here, below;
};

float relative_blur_at(int x, int y) {
    return imageLoad(relative_blur, ivec3(clamp(ivec2(x, y), ivec2(0), ivec2(width, height) - 1), 0)).r;
}

Line line_at(int x, int y) {
    return Line(relative_blur_at(x - 2, y),
                vec4(relative_blur_at(x - 1, y), relative_blur_at(x, y), relative_blur_at(x + 1, y),
                     relative_blur_at(x + 2, y)),
                relative_blur_at(x + 3, y));
}

// φ = 1/sqrt(|∇V|² + η²) of a line between two others.
vec4 inverse_gradient(Line above, Line here, Line below) {
    vec4 gx = 0.5 * vec4(here.middle.y - here.left, here.middle.zw - here.middle.xy, here.right - here.middle.z);
    vec4 gy = 0.5 * (below.middle - above.middle);
    return inversesqrt(gx * gx + gy * gy + smoothness_eta * smoothness_eta);
}

void go_down(inout Around a, Line next) {
    a.above = a.here;
    a.here = a.below;
    a.below = a.next;
    a.next = next;
    a.phi_above = a.phi;
    a.phi = a.phi_below;
    a.phi_below = inverse_gradient(a.here, a.below, a.next);
}

int line_inside(int y) {
    return reflect_once(ivec2(min(y, height)), ivec2(height)).x;
}

void go_down(inout Sharp s, vec4 next) {
    s.above = s.here;
    s.here = s.below;
    s.below = next;
}

// Line y of both sharp images becomes the one below.
void load_line(inout Sharp first, inout Sharp second, ivec4 columns, int y) {
    int line = line_inside(y);
    vec4 next1, next2;
    [[unroll]] for (int n = 0; n < 4; n++) {
        vec2 both = coefficients(ivec3(columns[n], line, 0));
        next1[n] = both.x;
        next2[n] = both.y;
    }
    go_down(first, next1);
    go_down(second, next2);
}

Stencil part(Sharp s, int k) {
    return k == 0 ? Stencil(s.above.xyz, s.here.xyz, s.below.xyz) : Stencil(s.above.yzw, s.here.yzw, s.below.yzw);
}

// V of a pixel and its neighbours, right, left, lower, upper; φ likewise.
struct Relative {
    float v;
    vec4 around;
    float phi;
    vec4 phis;
};

struct Data {
    float s1, s2;                    // residuals
    float d1, d2;                    // their derivatives by V, without the part of noise
    float w1, w2;                    // H ψ', (1-H) ψ'
    float psi;                       // H ψ(S1²) + (1-H) ψ(S2²)
    float s;                         // H S1 - (1-H) S2
    vec2 j1, j2;                     // of -S1, of S2, by T's displacement in I1's pixels
};

// Half the derivative by V of the logarithm of the noise of both images in S1² and S2².
vec2 noise_slopes(Registration r, float v, vec2 d) {
    float between = interpolated_power(d), square = r.gain * r.gain;
    Power n1, n2;
    if (v >= 0.0) {
        n1 = blurred_power(noise, v, 1.0);
        n2 = beyond_power(noise, v, between, NEAR);
    } else {
        n1 = beyond_power(noise, -v, 1.0, NEAR);
        n2 = blurred_power(noise, -v, between);
    }
    float sign = v >= 0.0 ? 0.5 : -0.5;
    return sign * vec2(n1.slope / (n1.value + square * between), square * n2.slope / (square * n2.value + 1.0));
}

// `share` is the share by which the pixel counts, d its displacement by T.
Data data_term(Registration r, float v, PairSample both, float share, vec2 d) {
    float s1 = both.b1.value - (r.gain * both.j.value + r.offset);
    float s2 = r.gain * both.b2.value + r.offset - both.i1;
    vec2 along_noise = noise_slopes(r, v, d);
    // Clamped, since a device's atan may overshoot and weights must not be negative.
    float heaviside = clamp(0.5 + atan(v / epsilon) / PI, 0.0, 1.0);
    float psi1 = sqrt(s1 * s1 + eta * eta), psi2 = sqrt(s2 * s2 + eta * eta);
    float first = share * heaviside, second = share - first;
    return Data(s1, s2, both.b1.slope - along_noise.x * s1, r.gain * both.b2.slope - along_noise.y * s2, first / psi1, second / psi2,
                heaviside * psi1 + (1.0 - heaviside) * psi2, heaviside * s1 - (1.0 - heaviside) * s2, r.gain * both.j.gradient, r.gain * both.b2.gradient);
}

// The noise of the previous iteration, at least that of η.
float spread() { return max(state.spread, eta / BROAD); }

// The contribution of two adjacent pixels to the spread: a bounded square, whose mean is a half where the spread is
// right.
float spreads(float difference) {
    float square = 0.5 * difference * difference;
    return 2.0 * square / (square + BOUND * BOUND * spread() * spread());
}

// D and b of the pixel. Adds it to the sums, with dV eliminated by the pixel's own smoothness.
vec2 equation(ivec2 x, vec2 p, Relative relative, bool valid, float share, Data t, inout Sums sums) {
    if (!valid) return vec2(0.0);
    bvec4 exists = bvec4(x.x + 1 < width, x.x > 0, x.y + 1 < height, x.y > 0);
    vec4 a = mix(vec4(0.0), 0.5 * continuation * state.alpha * (relative.phi + relative.phis), exists);
    float d = t.w1 * t.d1 * t.d1 + t.w2 * t.d2 * t.d2;
    float b = -(t.w1 * t.s1 * t.d1 + t.w2 * t.s2 * t.d2);
    float right_side = b + dot(a, relative.around - relative.v);
    float over = 1.0 / max(d + elimination * (a.x + a.y + a.z + a.w), 1e-12);
    vec2 q = t.w2 * t.d2 * t.j2 - t.w1 * t.d1 * t.j1;
    vec3 n = product(t.w1, t.j1) + product(t.w2, t.j2) - product(over, q);
    vec2 g = t.w2 * t.s2 * t.j2 - t.w1 * t.s1 * t.j1 + right_side * over * q;
    // Weights of T's step, with η of BROAD spreads.
    float broad = BROAD * spread();
    float ratio = t.psi * inversesqrt(t.psi * t.psi - eta * eta + broad * broad);
    add_pixel(sums, ratio * n, ratio * g, share * (t.psi + state.alpha / relative.phi), p / scale_length, share);
    float square = 1.0 / (relative.phi * relative.phi) - smoothness_eta * smoothness_eta;
    sums.variance += vec2(b * b, d);
    sums.roughness += share * vec2(sqrt(abs(b)), sqrt(max(square, 0.0)));
    return vec2(d, b);
}

int rows_of_sums() { return int(gl_NumWorkGroups.x * gl_NumWorkGroups.y); }
float length_of_places() { return scale_length; }
vec2 corner_place() { return vec2(centre[0], centre[1]); }

#include "update_transform.glsl"

shared bool is_last;

// Whether all other workgroups have stored their sums, which then are visible to this one.
bool is_last_workgroup() {
    memoryBarrierBuffer();
    barrier();
    if (gl_LocalInvocationIndex == 0) {
        memoryBarrierBuffer();
        is_last = atomicAdd(updated.finished, 1) + 1 == rows_of_sums();
        if (is_last) updated.finished = 0;
    }
    barrier();
    memoryBarrierBuffer();
    return is_last;
}

void main() {
    Sums sums = no_sums();
    Registration r = state.registration;
    Registration moved = moved_since(state.warped, r);
    float scale = scale_of(r);
    ivec2 size = ivec2(width, height);
    vec2 centre = vec2(centre[0], centre[1]);
    Blur blur = Blur(size, nodes, vec2(mean[0], mean[1]));
    ivec2 x = ivec2(2 * gl_GlobalInvocationID.x, rows * gl_GlobalInvocationID.y);
    // Invocations outside the level load from its last pixels, and add and store nothing.
    int left = min(x.x, size.x - 1);
    ivec4 columns = ivec4(reflect_once(ivec2(left - 1, left), size.xx), reflect_once(ivec2(left + 1, left + 2), size.xx));
    Around a;
    a.here = line_at(x.x, x.y - 2);
    a.below = line_at(x.x, x.y - 1);
    a.next = line_at(x.x, x.y);
    a.phi_below = inverse_gradient(a.here, a.below, a.next);
    go_down(a, line_at(x.x, x.y + 1));
    Sharp sharp1, sharp2;
    if (WARPED) {
        load_line(sharp1, sharp2, columns, x.y - 1);
        load_line(sharp1, sharp2, columns, x.y);
    }
    for (int n = 0; n < rows; n++, x.y++) {
        go_down(a, line_at(x.x, x.y + 2));
        if (WARPED) load_line(sharp1, sharp2, columns, x.y + 1);
        ivec3 lines = ivec3(line_inside(x.y - 1), line_inside(x.y), line_inside(x.y + 1));
        float s_before = 0.0, share_before = 0.0;
        [[unroll]] for (int k = 0; k < 2; k++) {
            ivec2 at = x + ivec2(k, 0);
            vec4 v = a.here.middle;
            Relative relative = k == 0
                ? Relative(v.y, vec4(v.z, v.x, a.below.middle.y, a.above.middle.y), a.phi.y,
                           vec4(a.phi.z, a.phi.x, a.phi_below.y, a.phi_above.y))
                : Relative(v.z, vec4(v.w, v.y, a.below.middle.z, a.above.middle.z), a.phi.z,
                           vec4(a.phi.w, a.phi.y, a.phi_below.z, a.phi_above.z));
            vec2 d = displacement(r, at, factor, centre);
            bool valid = all(lessThan(at, size)) && inside(at, d, size, relative.v, scale);
            float share = counts(min(at, size - 1), d, size);
            PairSample both;
            if (WARPED) {
                both = blur_near(blur, relative.v, displacement(moved, at, factor, centre), part(sharp1, k), part(sharp2, k),
                                 k == 0 ? columns.xyz : columns.yzw, lines);
            } else {
                both = blur_apart(blur, r, at, relative.v, d, scale, imageLoad(image1, ivec3(min(at, size - 1), 0)).r);
            }
            Data t = data_term(r, relative.v, both, share, d);
            vec2 coefficients = equation(at, vec2(at) - centre, relative, valid, share, t, sums);
            if (k == 1 && valid) sums.spread += min(share_before, share) * spreads(t.s - s_before);
            s_before = t.s;
            share_before = valid ? share : 0.0;
            if (at.x < width && at.y < height) {
                imageStore(normal_equations, ivec3(at, 0), vec4(coefficients.x));
                imageStore(normal_equations, ivec3(at, 1), vec4(coefficients.y));
            }
        }
    }
    float sum = workgroup_sum(sums);
    uint n = gl_LocalInvocationIndex;
    if (n < SUMS) partials[(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * SUMS + n] = sum;
    if (is_set(STEPS) && is_last_workgroup()) update_transform();
}
