#version 460
// A filter along x, then one along y, with mirrored borders, in one dispatch. With stride 2 it halves the image. CPU
// reference: src/engine/stages/separable.rs.
//
// On a GPU this halves the traffic and the number of dispatches of two passes of convolve.

#extension GL_EXT_control_flow_attributes : require // arrays stay in registers only if loops are unrolled

const int VECTORS = 1024;            // of four weights: the 16 KiB that each device allows a uniform buffer

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32ui) uniform readonly uimage2DArray from;
layout(binding = 1, r32ui) uniform readonly uimage2DArray second;   // of the second layer, with JOINS
layout(binding = 2, r32ui) uniform writeonly uimage2DArray to;
layout(binding = 3, std140) uniform Filters { vec4 weights[VECTORS]; };
layout(binding = 4, std430) readonly buffer Tiles { uint tiles[]; };
layout(binding = 5, std430) readonly buffer StateBuffer { State state; };
layout(constant_id = 2) const bool LONG = false;    // filters of more than TAPS weights
layout(constant_id = 3) const bool JOINS = false;   // two layers of floats, of two images; with PACKED they are packed
layout(constant_id = 5) const bool HALVING = false; // stores every other result of either axis
layout(push_constant) uniform Constants {
    int width, height;          // before the filters
    int from_layer, to_layer;   // of the first layer; each workgroup along z filters one of two, or both if packed
    int from_step, to_step;     // from a layer to the next
    int planes;
    int offset_x, offset_y;     // of the filters among the vectors of weights
    int radius_x, radius_y;
    int period_x, period_y;     // pixels after which the mirrored image repeats
    int listed;                 // first entry of the list of tiles
    int blocks_x, blocks_y;     // blocks of weights of the filters
};

#include "tiles.glsl"
#include "stacks.glsl"

// Adjacent results per invocation: each weight and each value is loaded once for all of them.
const int SPAN = 8;
// The most weights of a filter that is not LONG. Others are zero.
const int TAPS = 19;
// Weights per block of a LONG filter, and its largest radius.
const int BLOCK = 20, REACH = 24;
// Results from one that is stored to the next.
const int STRIDE = HALVING ? 2 : 1;
const int TOTAL = 256;               // invocations
// Columns of results of a workgroup, and lines that it filters along x, with LONG filters.
const int COLUMNS = 32, LINES = 64, LONG_LINES = 96;
const int TALL = LONG ? LONG_LINES : LINES;
// Rounds in which the invocations take the spans along x.
const int ROUNDS = TALL * COLUMNS / SPAN > TOTAL ? 2 : 1;
// Lines of results of a workgroup.
const int RESULTS = (LONG ? LONG_LINES - 2 * REACH : LINES - TAPS + 1) / STRIDE;
// Weights at once, and values for the results of an invocation.
const int COUNT = LONG ? BLOCK : TAPS, VALUES = COUNT + STRIDE * (SPAN - 1);

// Photographs that a workgroup filters.
const int PHOTOGRAPHS = PACKED ? 2 : 1;

// Filtered along x. One column more, so that lines begin in different banks.
shared float filtered[PHOTOGRAPHS][TALL][COLUMNS + 1];

int mirrored(int place, int period, int length) {
    place = abs(place);
    return clamp(min(place, period - place), 0, length - 1);
}

void add(inout float sums[SPAN], float values[VALUES], int offset) {
    [[unroll]] for (int j = 0; j < SPAN; j++) {
        [[unroll]] for (int m = 0; m < COUNT; m++) sums[j] += weights[offset + m / 4][m % 4] * values[STRIDE * j + m];
    }
}

// The texels of a span along x, from the image of a layer.
void load(int plane, int x, int y, int layer, out uint texels[VALUES]) {
    if (!JOINS || plane == 0) {
        [[unroll]] for (int m = 0; m < VALUES; m++)
            texels[m] = imageLoad(from, ivec3(mirrored(x + m, period_x, width), y, layer)).r;
    } else {
        [[unroll]] for (int m = 0; m < VALUES; m++)
            texels[m] = imageLoad(second, ivec3(mirrored(x + m, period_x, width), y, layer)).r;
    }
}

const float NONE[SPAN] = { 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 };

void main() {
    int plane = int(gl_WorkGroupID.z), source = from_layer + plane * from_step, target = to_layer + plane * to_step;
    ivec2 tile = ivec2(COLUMNS, RESULTS) * ivec2(tile_at(listed));
    ivec2 size = (ivec2(width, height) + STRIDE - 1) / STRIDE;
    int n = int(gl_LocalInvocationIndex);
    // Packed coefficients are in whites.
    float scale = PACKED && JOINS ? 1.0 / max(uintBitsToFloat(state.white), LEAST_WHITE) : 1.0;
    // Spans along x.
    [[unroll]] for (int round = 0; round < ROUNDS; round++) {
        int line = (n + round * TOTAL) / (COLUMNS / SPAN), column = n % (COLUMNS / SPAN) * SPAN;
        if (line >= TALL) continue;
        int y = mirrored(STRIDE * tile.y - radius_y + line, period_y, height);
        int x = STRIDE * (tile.x + column) - radius_x;
        float sums[PHOTOGRAPHS][SPAN];
        [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) sums[i] = NONE;
        for (int block = 0; block < (LONG ? blocks_x : 1); block++) {
            uint texels[VALUES];
            [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) {
                // Packed texels are loaded once for both photographs.
                if (i == 0 || JOINS) load(PACKED ? i : plane, x + BLOCK * block, y, source + i * from_step, texels);
                float values[VALUES];
                [[unroll]] for (int m = 0; m < VALUES; m++)
                    values[m] = PACKED && !JOINS ? unpacked(texels[m], i + 1) : uintBitsToFloat(texels[m]);
                add(sums[i], values, offset_x + BLOCK / 4 * block);
            }
        }
        [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++)
            [[unroll]] for (int j = 0; j < SPAN; j++) filtered[i][line][column + j] = scale * sums[i][j];
    }
    barrier();
    if (n < (RESULTS + SPAN - 1) / SPAN * COLUMNS) {
        int line = n / COLUMNS * SPAN, column = n % COLUMNS;
        ivec2 x = tile + ivec2(column, line);
        float sums[PHOTOGRAPHS][SPAN];
        [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) {
            sums[i] = NONE;
            for (int block = 0; block < (LONG ? blocks_y : 1); block++) {
                float values[VALUES];
                [[unroll]] for (int m = 0; m < VALUES; m++)
                    values[m] = filtered[i][min(STRIDE * line + BLOCK * block + m, TALL - 1)][column];
                add(sums[i], values, offset_y + BLOCK / 4 * block);
            }
        }
        [[unroll]] for (int j = 0; j < SPAN; j++) {
            uint texel = PACKED ? packed_texel(sums[0][j], sums[PHOTOGRAPHS - 1][j]) : floatBitsToUint(sums[0][j]);
            if (line + j < RESULTS && x.x < size.x && x.y + j < size.y)
                imageStore(to, ivec3(x.x, x.y + j, target), uvec4(texel));
        }
    }
}
