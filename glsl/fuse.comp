#version 460
// One channel of the fused image, equation 37: the sharper of I1 and J at each pixel. CPU reference:
// src/engine/stages/fuse.rs.

#include "spline.glsl"
#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray channel1;
layout(binding = 1, r32f) uniform readonly image2DArray spline2;       // coefficients of the channel of I2
layout(binding = 2, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 3, r32f) uniform writeonly image2DArray result;
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // target
    float centre_x, centre_y;
    float epsilon;
};

float coefficient(int image, ivec3 place) {
    return imageLoad(spline2, place).r;
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy), size = ivec2(width, height), i;
    if (x.x >= width || x.y >= height) return;
    Registration r = state.registration;
    vec2 centre = vec2(centre_x, centre_y), d = displacement(r, x, 1.0, centre), f;
    float fused = imageLoad(channel1, ivec3(x, 0)).r;
    if (inside(x, d, size, 0.0, 1.0)) {
        place(x, d, size, i, f);
        float shading = shading_at(state.applied_shading, (vec2(x) + d - centre) / centre);
        float j = r.gain * shading * spline_at(2, 0, size, i, f).value + r.offset;
        float v = imageLoad(relative_blur, ivec3(x, 0)).r;
        fused = mix(j, fused, clamp(0.5 + atan(v / epsilon) / 3.14159265358979, 0.0, 1.0));
    }
    imageStore(result, ivec3(x, layer), vec4(fused));
}
