#version 460
// A filter along one axis, mirrored borders; with stride 2 it halves that axis. Twin: src/stages/convolve.rs.

#include "border.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray from;
layout(binding = 1, r32f) uniform image2DArray to;
layout(binding = 2, std140) uniform Filters { vec4 weights[1024]; }; // four a vector; SPAN - 1 zeros after each filter
layout(constant_id = 2) const bool ADD = false;     // to what is there
layout(push_constant) uniform Constants {
    int length, breadth;        // along the filtered axis and across it, before the filter
    int stride;
    int vertical;
    int from_layer, to_layer;
    int offset, radius;         // of the filter within the weights
};

// Neighbouring results an invocation: each weight and each value is loaded once for all of them.
const int SPAN = 8;

ivec3 place(int along, int across, int layer) {
    return vertical == 1 ? ivec3(across, along, layer) : ivec3(along, across, layer);
}

void main() {
    ivec2 id = ivec2(gl_GlobalInvocationID.xy);
    int first = SPAN * (vertical == 1 ? id.y : id.x), across = vertical == 1 ? id.x : id.y;
    if (first >= length || across >= breadth) return;
    vec4 low = vec4(0.0), high = vec4(0.0);         // the results
    vec4 low_window = vec4(0.0), high_window = vec4(0.0); // the weights that they give to the value at hand
    bool whole = first >= radius && first + SPAN + radius <= length;
    for (int n = 0; n < 2 * radius + SPAN; n++) {
        high_window = vec4(low_window.w, high_window.xyz);
        low_window = vec4(weights[(offset + n) >> 2][(offset + n) & 3], low_window.xyz);
        int along = first - radius + n;
        float value = imageLoad(from, place(whole ? along : mirror(along, length), across, from_layer)).r;
        low += low_window * value;
        high += high_window * value;
    }
    float sums[SPAN] = float[](low.x, low.y, low.z, low.w, high.x, high.y, high.z, high.w);
    for (int j = 0; j < SPAN; j += stride) {
        if (first + j >= length) break;
        ivec3 result = place((first + j) / stride, across, to_layer);
        imageStore(to, result, vec4(ADD ? imageLoad(to, result).r + sums[j] : sums[j]));
    }
}
