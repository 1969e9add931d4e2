#version 460
// Computes D and b of each pixel's equation for dV, and the registration integrals, from V, I1, I2 and T. Equations 22
// to 32 and 23. CPU reference: src/engine/stages/linearise.rs.
//
// An invocation computes one column and keeps the surrounding lines in registers: V and its inverse gradient are loaded
// once per line instead of once per pixel. Two columns at once took twice the registers.

#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a kernel without a mean.
layout(constant_id = 3) const bool WARPED = false;

#include "blur.glsl"
#include "accumulate.glsl"
#include "noise.glsl"
#include "mask.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;         // of I1, then of I2
layout(binding = 2, r32f) uniform writeonly image2DArray normal_equations; // D, b
layout(binding = 3, std430) readonly buffer StateBuffer { State state; };
layout(binding = 4, std430) coherent buffer Partials { float partials[]; };
layout(binding = 5, r32f) uniform readonly image2DArray masks;          // of I1, of I2
layout(binding = 6, std430) buffer UpdatedBuffer { State updated; };     // the state, by the last workgroup
// What includes update_transform.glsl must not read `state` after it: a compiler may take it for other memory.
layout(binding = 7, std430) writeonly buffer Energies { float energies[]; };
layout(binding = 8, std430) writeonly buffer Arguments { uint arguments[]; };
layout(binding = 9, std430) readonly volatile buffer AllArguments { uint start_arguments[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int second_stack;                // its first layer
    int rows;                        // lines per invocation, an even number
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    float scale_length;              // L, the length that places are divided by, pixels
    float continuation;              // factor by which α is larger than its final value
    float eta, smoothness_eta;
    float elimination;               // share of Σa that damps the elimination of dV
    float mean[2];                   // of the kernel at variance 1
    Noise noise;                     // of either image
    Step t_step;
};

const float BOUND = 0.612;

#include "pair.glsl"
#include "data.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

// A line of V: columns -2 to 2.
struct Line {
    float left;
    vec3 middle;
    float right;
};

// In registers: V of the lines -1 to 2 from the current one, φ of -1 to 1, columns -1 to 1.
struct Around {
    Line above, here, below, next;
    vec3 phi_above, phi, phi_below;
};

float relative_blur_at(int x, int y) {
    return imageLoad(relative_blur, ivec3(clamp(ivec2(x, y), ivec2(0), ivec2(width, height) - 1), 0)).r;
}

Line line_at(int x, int y) {
    return Line(relative_blur_at(x - 2, y),
                vec3(relative_blur_at(x - 1, y), relative_blur_at(x, y), relative_blur_at(x + 1, y)),
                relative_blur_at(x + 2, y));
}

// φ = 1/sqrt(|∇V|² + η²) of a line between two others.
vec3 inverse_gradient(Line above, Line here, Line below) {
    vec3 gx = 0.5 * vec3(here.middle.y - here.left, here.middle.z - here.middle.x, here.right - here.middle.y);
    vec3 gy = 0.5 * (below.middle - above.middle);
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

// V of a pixel and its neighbours, right, left, lower, upper; φ likewise.
struct Relative {
    float v;
    vec4 around;
    float phi;
    vec4 phis;
};

// The contribution of two adjacent pixels of a column to the spread: a bounded square, whose mean is a half where the
// spread is right.
float spreads(float difference) {
    float square = 0.5 * difference * difference;
    return 2.0 * square / (square + BOUND * BOUND * spread() * spread());
}

// D and b of the pixel. Adds it to the sums, with dV eliminated by the pixel's own smoothness.
vec2 equation(ivec2 x, vec2 p, Relative relative, bool valid, float share, Data t, inout Sums sums) {
    if (!valid) return vec2(0.0);
    bvec4 exists = bvec4(x.x + 1 < width, x.x > 0, x.y + 1 < height, x.y > 0);
    vec4 a = mix(vec4(0.0), 0.5 * continuation * state.alpha * (relative.phi + relative.phis), exists);
    float d = t.weight * t.by_v * t.by_v, b = -(t.weight * t.s * t.by_v);
    float right_side = b + dot(a, relative.around - relative.v);
    float over = 1.0 / max(d + elimination * (a.x + a.y + a.z + a.w), 1e-12);
    vec2 q = t.weight * t.by_v * t.by_place;
    vec3 n = product(t.weight, t.by_place) - product(over, q);
    vec2 g = t.weight * t.s * t.by_place + right_side * over * q;
    float ratio = broadened(t.psi);
    add_pixel(sums, ratio * n, ratio * g, share * (t.psi + state.alpha / relative.phi), p.y / scale_length, share);
    float square = 1.0 / (relative.phi * relative.phi) - smoothness_eta * smoothness_eta;
    sums.variance += vec2(b * b, d);
    // α is estimated without the part of parallax: with it a larger parallax raises α, and a larger α shrinks V.
    vec2 parallax = parallax_by_v(state.parallax, vec2(x), factor, vec2(centre[0], centre[1]));
    float by_blur = t.weight * t.s * (t.by_v - dot(t.by_place, parallax));
    sums.roughness += share * vec2(sqrt(abs(by_blur)), sqrt(max(square, 0.0)));
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
        if (is_last) atomicExchange(updated.finished, 0);
    }
    barrier();
    memoryBarrierBuffer();
    return is_last;
}

void main() {
    Sums sums = no_sums();
    Registration r = state.registration;
    float scale = scale_of(r), separation = state.separation / (factor * factor);
    ivec2 size = ivec2(width, height);
    vec2 centre = vec2(centre[0], centre[1]);
    ivec2 x = ivec2(gl_GlobalInvocationID.x, rows * gl_GlobalInvocationID.y);
    Around a;
    a.here = line_at(x.x, x.y - 2);
    a.below = line_at(x.x, x.y - 1);
    a.next = line_at(x.x, x.y);
    a.phi_below = inverse_gradient(a.here, a.below, a.next);
    go_down(a, line_at(x.x, x.y + 1));
    float s_before = 0.0, share_before = 0.0;
    for (int n = 0; n < rows; n++, x.y++) {
        go_down(a, line_at(x.x, x.y + 2));
        vec3 v = a.here.middle;
        Relative relative = Relative(v.y, vec4(v.z, v.x, a.below.middle.y, a.above.middle.y), a.phi.y,
                                     vec4(a.phi.z, a.phi.x, a.phi_below.y, a.phi_above.y));
        vec2 d = displacement_of(r, state.parallax, vec2(x), relative.v, factor, centre);
        Variances of = variances_at(relative.v, separation);
        bool valid = all(lessThan(x, size)) && inside(x, d, size, of, scale);
        // Invocations outside the level load from its last pixels, and add and store nothing.
        ivec2 from = min(x, size - 1);
        float share = counts(from, d, size);
        Data t = data_term(r, of, sample_pair(from, d, of, factor), share, d, x);
        vec2 coefficients = equation(x, vec2(x) - centre, relative, valid, share, t, sums);
        if (n % 2 == 1 && valid) sums.spread += min(share_before, share) * spreads(t.s - s_before);
        s_before = t.s;
        share_before = valid ? share : 0.0;
        if (x.x < width && x.y < height) {
            imageStore(normal_equations, ivec3(x, 0), vec4(coefficients.x));
            imageStore(normal_equations, ivec3(x, 1), vec4(coefficients.y));
        }
    }
    float sum = workgroup_sum(sums, (float(x.x) - centre.x) / scale_length);
    uint n = gl_LocalInvocationIndex;
    if (n < SUMS) partials[(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * SUMS + n] = sum;
    if (is_set(STEPS) && is_last_workgroup()) update_transform();
}
