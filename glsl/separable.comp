#version 460
// A filter along x, then one along y, with mirrored borders, in one dispatch. With stride 2 it halves the image. CPU
// reference: src/engine/stages/separable.rs.

#extension GL_EXT_control_flow_attributes : require // arrays stay in registers only if loops are unrolled

const int VECTORS = 1024;            // of four weights: the 16 KiB that each device allows a uniform buffer

#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32ui) uniform readonly uimage2DArray from;
layout(binding = 1, r32ui) uniform readonly uimage2DArray second;   // of the second layer, with JOINS
layout(binding = 2, r32ui) uniform uimage2DArray to;
layout(binding = 3, std140) uniform Filters { vec4 filters[VECTORS]; };
layout(binding = 4, std430) readonly buffer Tiles { uint tiles[]; };
layout(binding = 5, std430) readonly buffer StateBuffer { State state; };
layout(constant_id = 2) const bool ANY = false;     // any filters on any sides; else of TAPS weights
layout(constant_id = 3) const bool JOINS = false;   // two layers of floats, of two images; with PACKED they are packed
layout(constant_id = 5) const bool HALVING = false; // stores every other result of either axis
layout(push_constant) uniform Constants {
    int width, height;          // before the filters
    int from_layer, to_layer;   // of the first layer; each workgroup along z filters one of two, or both if packed
    int from_step, to_step;     // from a layer to the next
    int planes;
    int offsets[2];             // of the filters among the vectors of weights
    int radii[2];
    int periods[2];             // pixels after which the mirrored image repeats
    int listed;                 // first entry of the list of tiles
    int blocks[2];              // blocks of weights of the filters
    int add;                    // 1: adds to the target, which is not packed; only with ANY
};

#include "tiles.glsl"
#include "stacks.glsl"

// Results from one that is stored to the next.
const int STRIDE = HALVING ? 2 : 1;
// Weights per block of ANY filter.
const int BLOCK = 20;

#include "filter.glsl"

const int TOTAL = 256;               // invocations
// Photographs that a workgroup filters.
const int PHOTOGRAPHS = PACKED ? 2 : 1;
// Columns of results of a workgroup. Lines that it filters along x, for TAPS weights along y.
const int COLUMNS = 32, LINES = 64;
// With ANY: lines of the image that become results, and the blocks of weights along y for which lines are filtered
// along x at once. Filters of packed layers have no more.
const int ANY_LINES = 48, CHUNK = 3;
const int RESULTS = (ANY ? ANY_LINES : LINES - TAPS + 1) / STRIDE;
const int TALL = ANY ? ANY_LINES + BLOCK * CHUNK : LINES;
// Rounds in which the invocations take the spans along x.
const int ROUNDS = (TALL * COLUMNS / SPAN + TOTAL - 1) / TOTAL;

// Filtered along x. One column more, so that lines begin in different banks.
shared float filtered[PHOTOGRAPHS][TALL][COLUMNS + 1];

int mirrored(int place, int period, int length) {
    place = abs(place);
    // Filters of TAPS weights on long sides reach beyond one end only, and by less than a period.
    if (ANY) place -= period * int(float(place) * (1.0 / float(period)));
    return clamp(min(place, period - place), 0, length - 1);
}

// The texels of a span along x, from the image of a layer.
void load(int plane, int x, int y, int layer, out uint texels[VALUES]) {
    if (!JOINS || plane == 0) {
        [[unroll]] for (int m = 0; m < VALUES; m++)
            texels[m] = imageLoad(from, ivec3(mirrored(x + m, periods[0], width), y, layer)).r;
    } else {
        [[unroll]] for (int m = 0; m < VALUES; m++)
            texels[m] = imageLoad(second, ivec3(mirrored(x + m, periods[0], width), y, layer)).r;
    }
}

// Filters `lines` lines from y on along x.
void filter_along_x(int x, int y, int lines, int plane) {
    int n = int(gl_LocalInvocationIndex), source = from_layer + plane * from_step;
    // Packed coefficients are in whites.
    float scale = PACKED && JOINS ? 1.0 / max(uintBitsToFloat(state.white), LEAST_WHITE) : 1.0;
    [[unroll]] for (int round = 0; round < ROUNDS; round++) {
        int line = (n + round * TOTAL) / (COLUMNS / SPAN), column = n % (COLUMNS / SPAN) * SPAN;
        if (line >= lines) continue;
        int from_y = mirrored(y + line, periods[1], height), from_x = x + STRIDE * column;
        float sums[PHOTOGRAPHS][SPAN];
        [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) sums[i] = NONE;
        for (int block = 0; block < (ANY ? blocks[0] : 1); block++) {
            uint texels[VALUES];
            [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) {
                // Packed texels are loaded once for both photographs.
                if (i == 0 || JOINS)
                    load(PACKED ? i : plane, from_x + BLOCK * block, from_y, source + i * from_step, texels);
                float values[VALUES];
                [[unroll]] for (int m = 0; m < VALUES; m++)
                    values[m] = PACKED && !JOINS ? unpacked(texels[m], i + 1) : uintBitsToFloat(texels[m]);
                weigh(offsets[0] + BLOCK / 4 * block, values, sums[i]);
            }
        }
        [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++)
            [[unroll]] for (int j = 0; j < SPAN; j++) filtered[i][line][column + j] = scale * sums[i][j];
    }
    barrier();
}

// Adds what the blocks of weights from `first` on weigh along y, after the filter along x.
void filter_chunk(int first, ivec2 tile, int plane, int line, int column, inout float sums[PHOTOGRAPHS][SPAN]) {
    int lines = STRIDE * (RESULTS - 1) + (ANY ? min(BLOCK * CHUNK, 2 * radii[1] + 1 - BLOCK * first) : TAPS);
    filter_along_x(STRIDE * tile.x - radii[0], STRIDE * tile.y - radii[1] + BLOCK * first, lines, plane);
    if (line < RESULTS) {
        [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) {
            for (int block = 0; block < (ANY ? min(CHUNK, blocks[1] - first) : 1); block++) {
                float values[VALUES];
                [[unroll]] for (int m = 0; m < VALUES; m++)
                    values[m] = filtered[i][min(STRIDE * line + BLOCK * block + m, lines - 1)][column];
                weigh(offsets[1] + BLOCK / 4 * (first + block), values, sums[i]);
            }
        }
    }
}

void main() {
    int plane = int(gl_WorkGroupID.z), target = to_layer + plane * to_step;
    ivec2 tile = ivec2(COLUMNS, RESULTS) * ivec2(tile_at(listed));
    ivec2 size = (ivec2(width, height) + STRIDE - 1) / STRIDE;
    int n = int(gl_LocalInvocationIndex), line = n / COLUMNS * SPAN, column = n % COLUMNS;
    float sums[PHOTOGRAPHS][SPAN];
    [[unroll]] for (int i = 0; i < PHOTOGRAPHS; i++) sums[i] = NONE;
    filter_chunk(0, tile, plane, line, column, sums);
    if (ANY && !PACKED) {
        for (int first = CHUNK; first < blocks[1]; first += CHUNK) {
            barrier();
            filter_chunk(first, tile, plane, line, column, sums);
        }
    }
    if (line >= RESULTS) return;
    ivec2 x = tile + ivec2(column, line);
    [[unroll]] for (int j = 0; j < SPAN; j++) {
        if (line + j >= RESULTS || x.x >= size.x || x.y + j >= size.y) continue;
        ivec3 place = ivec3(x.x, x.y + j, target);
        float sum = sums[0][j];
        if (ANY && !PACKED && add == 1) sum += uintBitsToFloat(imageLoad(to, place).r);
        imageStore(to, place, uvec4(PACKED ? packed_texel(sum, sums[PHOTOGRAPHS - 1][j]) : floatBitsToUint(sum)));
    }
}
