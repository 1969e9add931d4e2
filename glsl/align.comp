#version 460
// Resamples a frame of a sweep onto the reference's pixels, by T and by the parallax of u, and matches its brightness.
// CPU reference: src/engine/stages/align.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;

#include "spline.glsl"
#include "state.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray spline;
layout(binding = 1, r32f) uniform writeonly image2DArray aligned;
layout(binding = 2, r32f) uniform readonly image2DArray focus;
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    Registration registration;
    float shading[TERMS];
    float parallax[2];               // pixels of this level per setting
};

float unit_of_coefficients() { return 1.0; }
float coefficient(int image, ivec3 place) { return imageLoad(spline, place).r; }

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy), size = ivec2(width, height), i;
    if (x.x >= width || x.y >= height) return;
    vec2 centre = vec2(centre[0], centre[1]), f;
    vec2 moves = imageLoad(focus, ivec3(x, 0)).r * vec2(parallax[0], parallax[1]);
    vec2 d = moves + displacement_at(registration, vec2(x) + moves, factor, centre);
    place(x, d, size, i, f);
    float bright = registration.gain * shading_at(shading, (vec2(i) + f - centre) / centre);
    imageStore(aligned, ivec3(x, layer), vec4(bright * spline_at(0, 0, size, i, f).value + registration.offset));
}
