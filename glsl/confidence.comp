#version 460
// V where it is valid, NaN elsewhere, and its confidence D/(D + Σa). Twin: src/stages/confidence.rs.

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, rgba32f) uniform readonly image2DArray weights;    // of the linear system: layer 0 red, layer 1 black
layout(binding = 2, r32f) uniform writeonly image2DArray result;       // layer 0: V, layer 1: confidence
layout(binding = 3, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    float centre_x, centre_y;
};

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    vec4 a = imageLoad(weights, ivec3(x.x / 2, x.y, x.x + x.y & 1));
    // The weights a are stored over D + Σa, so their sum falls short of 1 by the confidence; by less than 1e-5 is rounding.
    float confidence = 1.0 - (a.x + a.y + a.z + a.w);
    float v = imageLoad(relative_blur, ivec3(x, 0)).r;
    Registration r = state.registration;
    vec2 d = displacement(r, x, 1.0, vec2(centre_x, centre_y));
    bool valid = inside(x, d, ivec2(width, height), v, scale_of(r));
    imageStore(result, ivec3(x, 0), vec4(valid ? v : uintBitsToFloat(0x7fc00000u)));
    imageStore(result, ivec3(x, 1), vec4(valid && confidence > 1e-5 ? confidence : 0.0));
}
