#version 460
// Dense registration without a blur model, equation 36: the residual I1 - J at each pixel, its weight and its
// derivatives, summed for the registration step. CPU reference: src/engine/stages/appearance.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;

#include "spline.glsl"
#include "state.glsl"
#include "accumulate.glsl"
#include "mask.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray spline2;        // coefficients of I2
layout(binding = 2, std430) readonly buffer StateBuffer { State state; };
layout(binding = 3, std430) writeonly buffer Partials { float partials[]; };
layout(binding = 4, r32f) uniform readonly image2DArray masks;          // of I1, of I2
layout(push_constant) uniform Constants {
    int width, height;
    int rows;                        // pixels per invocation
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    float length;                    // L, the length that places are divided by, pixels
    float eta;
};

float unit_of_coefficients() { return 1.0; }
float coefficient(int image, ivec3 place) {
    return imageLoad(spline2, place).r;
}

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

void accumulate(Registration r, ivec2 x, inout Sums sums) {
    ivec2 size = ivec2(width, height), i;
    vec2 centre = vec2(centre[0], centre[1]), f;
    vec2 d = displacement(r, x, factor, centre);
    if (!is_seen_by_both(x, d, size)) return;
    float share = counts(x, d, size);
    place(x, d, size, i, f);
    Jet i2 = spline_at(2, 0, size, i, f);
    float s = imageLoad(image1, ivec3(x, 0)).r - (r.gain * i2.value + r.offset);
    float psi = sqrt(s * s + eta * eta);
    vec2 j = r.gain * i2.gradient * jacobian(r);         // of -S
    add_pixel(sums, product(share / psi, j), -share * s / psi * j, share * psi, (float(x.y) - centre.y) / length, share);
}

void main() {
    Sums sums = no_sums();
    Registration r = state.registration;
    for (int n = 0; n < rows; n++) {
        ivec2 block = ivec2(gl_WorkGroupID.x, gl_WorkGroupID.y * rows + n);
        ivec2 x = block * ivec2(gl_WorkGroupSize.xy) + ivec2(gl_LocalInvocationID.xy);
        if (x.x < width && x.y < height) accumulate(r, x, sums);
    }
    float sum = workgroup_sum(sums, (float(gl_GlobalInvocationID.x) - centre[0]) / length);
    uint n = gl_LocalInvocationIndex;
    if (n < SUMS) partials[(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * SUMS + n] = sum;
}
