#version 460
// Resamples I2 onto I1's pixels and applies the shading; with parallax applies the shading alone. CPU reference: src/engine/stages/warp.rs.

#include "spline.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray spline2;        // coefficients of I2
layout(binding = 1, r32f) uniform writeonly image2DArray to;
layout(binding = 2, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
};

float unit_of_coefficients() { return 1.0; }
float coefficient(int image, ivec3 place) {
    return imageLoad(spline2, place).r;
}

// Lines per invocation, for which T and the shading are loaded once.
const int ROWS = 8;

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.x, ROWS * gl_GlobalInvocationID.y), size = ivec2(width, height), last = size - 1;
    if (x.x >= width || x.y >= height) return;
    Registration r = state.registration;
    bool displaces = is_some(state.parallax);
    float coefficients[TERMS] = state.shading;
    if (x == ivec2(0)) {
        state.warped = r;
        state.applied_shading = coefficients;
    }
    vec2 centre = vec2(centre[0], centre[1]);
    for (int end = min(x.y + ROWS, height); x.y < end; x.y++) {
        vec2 d = displaces ? vec2(0.0) : displacement(r, x, factor, centre), f;
        // Mirrored about the border pixels, once.
        d = mix(d, vec2(-2 * x) - d, lessThan(vec2(x) + d, vec2(0.0)));
        d = mix(d, vec2(2 * (last - x)) - d, greaterThan(vec2(x) + d, vec2(last)));
        ivec2 i;
        place(x, d, size, i, f);
        float shading = shading_at(coefficients, (vec2(x) + d - centre) / centre);
        imageStore(to, ivec3(x, layer), vec4(shading * spline_at(2, 0, size, i, f).value));
    }
}
