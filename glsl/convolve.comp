#version 460
// A filter along one axis with mirrored borders. With stride 2 it halves that axis. CPU reference:
// src/engine/stages/convolve.rs.

#extension GL_EXT_control_flow_attributes : require // arrays stay in registers only if loops are unrolled

const int VECTORS = 1024;            // of four weights: the 16 KiB that each device allows a uniform buffer

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray from;
layout(binding = 1, r32f) uniform image2DArray to;
layout(binding = 2, std140) uniform Filters { vec4 weights[VECTORS]; };
layout(binding = 3, std430) readonly buffer Tiles { uint tiles[]; };
layout(constant_id = 2) const bool LONG = false;    // a filter of several blocks, or one that adds; else of one block
layout(push_constant) uniform Constants {
    int length, breadth;        // along the filtered axis and across it, before the filter
    int stride;
    int vertical;
    int from_layer, to_layer;
    int offset;                 // of the filter among the vectors of weights
    int blocks;                 // in it
    int radius;
    int add;                    // 1: adds to the target
    float period;               // pixels after which the mirrored image repeats
    int listed;                 // first entry of the list of tiles
};

#include "tiles.glsl"

// Adjacent results per invocation: each weight and each value is loaded once for all of them.
const int SPAN = 8;
// Weights per block.
const int BLOCK = 20;

ivec3 place(int along, int across, int layer) {
    return vertical == 1 ? ivec3(across, along, layer) : ivec3(along, across, layer);
}

void main() {
    // A workgroup along x covers 512 pixels of a few lines; that of a listed tile is narrower.
    uvec2 shape = gl_WorkGroupSize.xy;
    if (LISTED && vertical == 0) shape = uvec2(shape.x >> 2, shape.y << 2);
    ivec2 id = invocation(tile_at(listed), shape);
    int first = SPAN * (vertical == 1 ? id.y : id.x), across = vertical == 1 ? id.x : id.y;
    if (first >= length || across >= breadth) return;
    float sums[SPAN];
    [[unroll]] for (int j = 0; j < SPAN; j++) {
        sums[j] = 0.0;
        if (LONG && add == 1 && first + j < length) sums[j] = imageLoad(to, place(first + j, across, to_layer)).r;
    }
    float inverse = 1.0 / period;
    int count = LONG ? blocks : 1;
    for (int block = 0; block < count; block++) {
        float start = float(first - radius + BLOCK * block);
        float values[BLOCK + SPAN - 1];
        [[unroll]] for (int n = 0; n < BLOCK + SPAN - 1; n++) {
            float a = abs(start + float(n));
            a -= period * floor(a * inverse);
            values[n] = imageLoad(from, place(int(min(a, period - a)), across, from_layer)).r;
        }
        [[unroll]] for (int m = 0; m < BLOCK; m++) {
            float weight = weights[offset + BLOCK / 4 * block + m / 4][m % 4];
            [[unroll]] for (int j = 0; j < SPAN; j++) sums[j] += weight * values[m + j];
        }
    }
    [[unroll]] for (int j = 0; j < SPAN; j++) {
        if (first + j < length && (j & (stride - 1)) == 0) {
            imageStore(to, place(first + j >> stride - 1, across, to_layer), vec4(sums[j]));
        }
    }
}
