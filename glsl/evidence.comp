#version 460
// What decided V, on every other pixel along x and y: D, b² and (∇²V)², out of the last linear system. Twin:
// src/engine/stages/evidence.rs.

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32f) uniform readonly image2DArray right_sides; // layer 0: red, which pixels of even x and y are
layout(binding = 2, rgba32f) uniform readonly image2DArray weights;  // likewise; right, left, down, up; over D + Σa
layout(binding = 3, r32f) uniform writeonly image2DArray evidence;   // half as wide and high; layers: D, b², (∇²V)²
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    float eta, smoothness_eta;
    float noise;                     // least deviation of a residual, intensities
};

float v_at(ivec2 x) {
    return imageLoad(relative_blur, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r;
}

vec2 gradient_at(ivec2 x) {
    const ivec2 R = ivec2(1, 0), D = ivec2(0, 1);
    return 0.5 * vec2(v_at(x + R) - v_at(x - R), v_at(x + D) - v_at(x - D));
}

float phi_at(vec2 gradient) {
    return inversesqrt(dot(gradient, gradient) + smoothness_eta * smoothness_eta);
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy), x = 2 * h;
    if (x.x >= width || x.y >= height) return;
    vec2 gradient = gradient_at(x);
    float phi = phi_at(gradient), v = v_at(x), smoothness = 0.0, pull = 0.0;
    const ivec2 BESIDE[4] = ivec2[](ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1));
    for (int n = 0; n < 4; n++) {
        ivec2 beside = x + BESIDE[n];
        bool exists = all(greaterThanEqual(beside, ivec2(0))) && all(lessThan(beside, ivec2(width, height)));
        float a = exists ? 0.5 * state.alpha * (phi + phi_at(gradient_at(beside))) : 0.0;
        smoothness += a;
        pull += a * (v_at(beside) - v);
    }
    vec4 shares = imageLoad(weights, ivec3(h.x, x.y, 0));
    float share = shares.x + shares.y + shares.z + shares.w;
    // By how much the shares fall short of 1; by less than 1e-6 is rounding.
    float missing = 1.0 - share;
    float both = smoothness / max(share, 1e-12);
    float d = missing > 1e-6 ? both * missing : 0.0;
    float b = both * imageLoad(right_sides, ivec3(h.x, x.y, 0)).r - pull;
    imageStore(evidence, ivec3(h, 0), vec4(d));
    imageStore(evidence, ivec3(h, 1), vec4(missing > 1e-6 ? b * b + noise * noise / eta * d : 0.0));
    // The divergence of central differences, two pixels apart, which noise of single pixels does not lift.
    float bend = 0.25 * (v_at(x + ivec2(2, 0)) + v_at(x - ivec2(2, 0)) + v_at(x + ivec2(0, 2)) + v_at(x - ivec2(0, 2))) - v;
    imageStore(evidence, ivec3(h, 2), vec4(bend * bend));
}
