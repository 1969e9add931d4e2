#version 460
// A filter along one axis, mirrored borders; with stride 2 it halves that axis. Twin: src/stages/convolve.rs.

#include "border.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray from;
layout(binding = 1, r32f) uniform writeonly image2DArray to;
layout(binding = 2, std430) readonly buffer Filters { float weights[]; };
layout(push_constant) uniform Constants {
    int width, height;          // of the result
    int length;                 // of the axis before the filter
    int stride;
    int vertical;
    int from_layer, to_layer;
    int offset, radius;         // of the filter within the weights
};

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    ivec3 place = ivec3(x, from_layer);
    int centre = stride * (vertical == 1 ? x.y : x.x);
    float sum = 0.0;
    if (centre >= radius && centre + radius < length) {
        ivec3 unit = vertical == 1 ? ivec3(0, 1, 0) : ivec3(1, 0, 0);
        place += unit * (centre - radius - (vertical == 1 ? x.y : x.x));
        for (int n = 0; n <= 2 * radius; n++, place += unit) sum += weights[offset + n] * imageLoad(from, place).r;
    } else {
        for (int n = 0; n <= 2 * radius; n++) {
            int along = mirror(centre + n - radius, length);
            if (vertical == 1) place.y = along; else place.x = along;
            sum += weights[offset + n] * imageLoad(from, place).r;
        }
    }
    imageStore(to, ivec3(x, to_layer), vec4(sum));
}
