#version 460
// All relaxation sweeps on the linear system for dV, on tiles with a halo. CPU reference:
// src/engine/stages/relax_tiles.rs.

#extension GL_EXT_control_flow_attributes : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray right_sides; // layer 0: red, layer 1: black
layout(binding = 1, rgba16f) uniform readonly image2DArray weights;  // likewise; right, left, down, up
layout(binding = 2, r32f) uniform writeonly image2DArray red;        // dV
layout(binding = 3, r32f) uniform writeonly image2DArray black;
layout(binding = 4, std430) readonly buffer GridSteps { float steps[]; };   // dV of the first coarse grid
layout(push_constant) uniform Constants {
    int width, height;
    int sweeps;
    float over_relaxation;
};

uvec2 halves[2][8];                  // weights as they are stored, by color and row

vec4 weights_at(int color, int row) {
    uvec2 w = halves[color][row];
    return vec4(unpackHalf2x16(w.x), unpackHalf2x16(w.y));
}

#include "relaxation_tile.glsl"

void load(ivec2 size) {
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            ivec3 place = ivec3(clamp(own + ivec2(0, row), ivec2(0), ivec2((size.x - 1) / 2, size.y - 1)), color);
            right_side[color][row] = imageLoad(right_sides, place).r;
            vec4 w = imageLoad(weights, place);
            halves[color][row] = uvec2(packHalf2x16(w.xy), packHalf2x16(w.zw));
        }
    }
}

void main() {
    ivec2 size = ivec2(width, height);
    place_tile(sweeps);
    load(size);
    start(0, size);
    relax_tile(sweeps, over_relaxation);
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        if (!is_written(row, size, sweeps)) continue;
        ivec3 place = ivec3(own + ivec2(0, row), 0);
        imageStore(red, place, vec4(dv[0][row]));
        imageStore(black, place, vec4(dv[1][row]));
    }
}
