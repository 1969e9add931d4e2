#version 460
// Relaxation sweeps on the linear system for dV, on tiles with a halo; then V ← V + share clamp(dV). JOINED: also those
// on all grids, before. CPU reference: src/engine/stages/relax_tiles.rs.

#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

#include "coarser.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray smoothed; // layer 0: D, averaged; RIGHT_SIDE
layout(binding = 1, rgba16f) uniform readonly image2DArray weights;  // by color; right, left, down, up
layout(binding = 2, std430) readonly buffer GridSteps { float steps[]; };   // dV of the first coarse grid, or of the level
layout(binding = 3, r32f) uniform image2DArray relative_blur;
layout(binding = 4, std430) buffer StateBuffer { State state; };
layout(binding = 5, r32f) uniform image2DArray kept; // layer KEPT: the sums of a whole step over blocks of 2 x 2 pixels
layout(binding = 6, std430) readonly buffer GridEquations { vec4 equations[]; };
layout(push_constant) uniform Constants {
    int width, height;
    int sweeps, halo;                    // sweeps here, and those that the halo of a tile is for
    float over_relaxation;
    float largest_step;                  // px² of the level, or
    float relative_step;                 // a share of |V|, if that is more
    float limit;                         // px² of the level
    float share;                         // of dV that is added
    int extrapolation;                   // KEEP, EXTRAPOLATE, or 0
    Coarser coarser;
};

const int RIGHT_SIDE = 1;            // the layer of the right sides

#include "cascade.glsl"

uvec2 halves[2][ROWS];               // weights as they are stored, by color and row; JOINED: see links

vec4 weights_at(int color, int row) {
    if (JOINED) return links[color][row];
    uvec2 w = halves[color][row];
    return vec4(unpackHalf2x16(w.x), unpackHalf2x16(w.y));
}

#include "update.glsl"

void load(ivec2 size) {
    [[unroll]] for (int row = 0; row < ROWS; row++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            ivec3 place = ivec3(clamp(own + ivec2(0, row), ivec2(0), ivec2((size.x - 1) / 2, size.y - 1)), color);
            int x = 2 * place.x + (place.y + color & 1);
            // Nothing beyond an odd width.
            right_side[color][row] =
                x < size.x ? imageLoad(smoothed, ivec3(x, place.y, RIGHT_SIDE)).r : 0.0;
            vec4 w = imageLoad(weights, place);
            if (JOINED) links[color][row] = w;
            else halves[color][row] = uvec2(packHalf2x16(w.xy), packHalf2x16(w.zw));
        }
    }
}

void main() {
    ivec2 size = ivec2(width, height);
    if (JOINED) relax_coarser_grids();
    place_tile(corner_of(0));
    load(size);
    start(size);
    relax_tile();
    Block blocks[ROWS / 2];
    // The blocks of the halo are written by other workgroups, and must not be read.
    [[unroll]] for (int row = 0; row < ROWS; row += 2) {
        blocks[row / 2] = Block(float[4](0.0, 0.0, 0.0, 0.0), float[4](0.0, 0.0, 0.0, 0.0), 0.0);
        if (is_written(row, size)) blocks[row / 2] = load_block(ivec2(2 * own.x, own.y + row));
    }
    uvec3 moving = uvec3(0);
    [[unroll]] for (int row = 0; row < ROWS; row += 2) {
        // By rows; a row begins with a red pixel, the next one with a black one.
        float change[4] = { dv[0][row], dv[1][row], dv[1][row + 1], dv[0][row + 1] };
        ivec2 first = ivec2(2 * own.x, own.y + row);
        moving += update_block(first, change, blocks[row / 2], is_written(row, size));
    }
    count(moving);
}
