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
layout(constant_id = 2) const bool LONG = false;    // any filter; else of TAPS weights, and replaces the target
layout(constant_id = 3) const bool VERTICAL = false;
layout(constant_id = 5) const bool HALVING = false; // stores every other result
layout(push_constant) uniform Constants {
    int length, breadth;        // along the filtered axis and across it, before the filter
    int from_layer, to_layer;   // of the first of `planes` layers; each workgroup along z filters one
    int from_step, to_step;     // from a layer to the next
    int planes;
    int offset;                 // of the filter among the vectors of weights
    int blocks;                 // in it
    int radius;
    int add;                    // 1: adds to the target
    int period;                 // pixels after which the mirrored image repeats
    int listed;                 // first entry of the list of tiles
};

#include "tiles.glsl"

// Adjacent results per invocation: each weight and each value is loaded once for all of them.
const int SPAN = 8;
// Weights per block.
const int BLOCK = 20;
// The most weights of a filter that is not LONG.
const int TAPS = 19;
// Results from one that is stored to the next.
const int STRIDE = HALVING ? 2 : 1;

ivec3 place(int along, int across, int layer) {
    return VERTICAL ? ivec3(across, along, layer) : ivec3(along, across, layer);
}

void main() {
    int plane = int(gl_WorkGroupID.z), source = from_layer + plane * from_step, target = to_layer + plane * to_step;
    // A workgroup along x covers 512 pixels of a few lines; that of a listed tile is narrower.
    uvec2 shape = gl_WorkGroupSize.xy;
    if (LISTED && !VERTICAL) shape = uvec2(shape.x >> 2, shape.y << 2);
    ivec2 id = invocation(tile_at(listed), shape);
    int first = SPAN * (VERTICAL ? id.y : id.x), across = VERTICAL ? id.x : id.y;
    if (first >= length || across >= breadth) return;
    float sums[SPAN];
    [[unroll]] for (int j = 0; j < SPAN; j++) {
        sums[j] = 0.0;
        if (LONG && add == 1 && first + j < length) sums[j] = imageLoad(to, place(first + j, across, target)).r;
    }
    float inverse = 1.0 / float(period);
    int blocks_here = LONG ? blocks : 1;
    const int COUNT = LONG ? BLOCK : TAPS;
    for (int block = 0; block < blocks_here; block++) {
        int start = first - radius + BLOCK * block;
        float values[COUNT + SPAN - 1];
        [[unroll]] for (int n = 0; n < COUNT + SPAN - 1; n++) {
            int a = abs(start + n);
            // A filter that is not LONG reaches beyond one end only, and by less than a period.
            if (LONG) a -= period * int(floor(float(a) * inverse));
            values[n] = imageLoad(from, place(min(a, period - a), across, source)).r;
        }
        [[unroll]] for (int m = 0; m < COUNT; m++) {
            float weight = weights[offset + BLOCK / 4 * block + m / 4][m % 4];
            [[unroll]] for (int j = 0; j < SPAN; j += STRIDE) sums[j] += weight * values[m + j];
        }
    }
    int room = length - first;
    [[unroll]] for (int j = 0; j < SPAN; j += STRIDE) {
        if (j < room) imageStore(to, place((first + j) / STRIDE, across, target), vec4(sums[j]));
    }
}
