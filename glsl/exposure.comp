#version 460
// Gain and offset from mean and deviation of the two images at low pass, each blurred as the other is by V. One workgroup.
// Twin: src/engine/stages/exposure.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"
#include "mask.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray image2;
layout(binding = 2, r32f) uniform readonly image2DArray relative_blur;  // of the level solved
layout(binding = 3, std430) buffer StateBuffer { State state; };
layout(binding = 4, r32f) uniform readonly image2DArray masks;          // of I1, of I2, at low pass
layout(push_constant) uniform Constants {
    int width, height;
    float factor;
    float centre_x, centre_y;
    int adopt;                       // 0: measure the correlation only
    int stride;                      // pixels of the level solved a pixel of this level
};

const int MOMENTS = 6;               // pixels, I1, I2, I1², I2², I1 I2; intensities less ½, for their digits
shared float by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][MOMENTS];

float intensity(int image, ivec2 i) {
    ivec3 place = ivec3(clamp(i, ivec2(0), ivec2(width, height) - 1), 0);
    return image == 1 ? imageLoad(image1, place).r : imageLoad(image2, place).r;
}

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

// A pixel blurred by a small variance: half of it times the Laplacian.
float blurred(int image, ivec2 i, float variance) {
    float centre = intensity(image, i);
    float sides = intensity(image, i + ivec2(1, 0)) + intensity(image, i - ivec2(1, 0))
                + intensity(image, i + ivec2(0, 1)) + intensity(image, i - ivec2(0, 1));
    return centre + 0.5 * variance * (sides - 4.0 * centre);
}

// Bilinear, which is enough for a mean and a deviation at low pass.
float read(int image, ivec2 i, vec2 f, float variance) {
    float top = mix(blurred(image, i, variance), blurred(image, i + ivec2(1, 0), variance), f.x);
    float bottom = mix(blurred(image, i + ivec2(0, 1), variance), blurred(image, i + ivec2(1, 1), variance), f.x);
    return mix(top, bottom, f.y);
}

// The place in I1 and its place in I2 that x lies half way between, from x: (1 + A)⁻¹ D, T's displacement D at x and its
// Jacobian A. Both are read as far from a pixel, so that interpolation takes as much contrast from one as from the other.
// Near a turn by 180° there is no such place, and I1 is read at x.
void meet(Registration r, vec2 d, out vec2 back, out vec2 ahead) {
    mat2 m = jacobian(r) + mat2(1.0);
    bool half_way = determinant(m) > 0.25;
    ahead = half_way ? inverse(m) * d : d;
    back = half_way ? -ahead : vec2(0.0);
}

void add(Registration r, ivec2 x, inout float moments[MOMENTS]) {
    vec2 displaced = displacement(r, x, factor, vec2(centre_x, centre_y)), back, ahead;
    meet(r, displaced, back, ahead);
    ivec2 size = ivec2(width, height), i, j;
    vec2 f, g;
    if (!inside(x, back, size, 0.0, 1.0) || !inside(x, ahead, size, 0.0, 1.0)) return;
    place(x, back, size, i, f);
    place(x, ahead, size, j, g);
    // In pixels of this level; ½ px² is as far as the Laplacian of a pixel goes.
    ivec2 solved = min(x * stride, imageSize(relative_blur).xy - 1);
    float variance = clamp(imageLoad(relative_blur, ivec3(solved, 0)).r / float(stride * stride), -0.5, 0.5);
    float u = read(1, i, f, max(variance, 0.0)) - 0.5;
    float v = read(2, j, g, max(-variance, 0.0)) - 0.5;
    float terms[MOMENTS] = float[](1.0, u, v, u * u, v * v, u * v);
    float share = counts(x, displaced, size);
    for (int n = 0; n < MOMENTS; n++) moments[n] += share * terms[n];
}

void main() {
    float moments[MOMENTS] = float[](0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    Registration r = state.registration;
    int step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int n = int(gl_LocalInvocationIndex); n < width * height; n += step) add(r, ivec2(n % width, n / width), moments);
    for (int n = 0; n < MOMENTS; n++) {
        float sum = subgroupAdd(moments[n]);
        if (subgroupElect()) by_subgroup[gl_SubgroupID][n] = sum;
    }
    barrier();
    if (gl_LocalInvocationIndex != 0) return;
    float m[MOMENTS];
    for (int n = 0; n < MOMENTS; n++) {
        m[n] = 0.0;
        for (uint group = 0; group < gl_NumSubgroups; group++) m[n] += by_subgroup[group][n];
    }
    float count = max(m[0], 1.0);
    vec2 mean = vec2(m[1], m[2]) / count;
    vec2 variance = max(vec2(m[3], m[4]) / count - mean * mean, vec2(0.0));
    float covariance = m[5] / count - mean.x * mean.y;
    // 1e-6: a deviation of 0.001, below which differences of squares are rounding.
    bool contrast = min(variance.x, variance.y) > 1e-6;
    state.correlation = contrast ? covariance / (sqrt(variance.x) * sqrt(variance.y)) : 0.0;
    if (adopt == 0) return;
    // Images that hardly correlate, still far apart say, tell nothing of the gain.
    float gain = state.correlation > 0.5 ? sqrt(variance.x / variance.y) : 1.0;
    state.registration.gain = gain;
    state.registration.offset = mean.x + 0.5 - gain * (mean.y + 0.5);
}
