#version 460
// Half a relaxation sweep on a coarse grid of the cascade: the red or the black cells. CPU reference:
// src/engine/stages/relax_grid.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool FIRST = false;               // first relaxation sweep: starts from the coarser grid
layout(binding = 0, std430) readonly buffer GridEquations { vec4 equations[]; };
layout(binding = 1, std430) buffer GridSteps { float steps[]; };
#include "grid_equations.glsl"

layout(push_constant) uniform Constants {
    int width, height;
    int first, next;                 // first cell of the grid and of the next coarser one
    int color;                       // 0 red: x + y even
    float over_relaxation;
};

const int LINES = 2;                 // per invocation

float own_at(ivec2 x) { return steps[first + x.y * width + x.x]; }

float coarse_at(ivec2 x) { return steps[next + x.y / 2 * ((width + 1) / 2) + x.x / 2]; }

// A neighbour, 0 beyond the border. While red is relaxed for the first time, black has no value yet.
float other_at(ivec2 x) {
    if (any(lessThan(x, ivec2(0))) || any(greaterThanEqual(x, ivec2(width, height)))) return 0.0;
    return FIRST && color == 0 ? coarse_at(x) : own_at(x);
}

void main() {
    for (int n = 0; n < LINES; n++) {
        int y = LINES * int(gl_GlobalInvocationID.y) + n;
        ivec2 x = ivec2(2 * int(gl_GlobalInvocationID.x) + (y + color & 1), y);
        if (x.x >= width || x.y >= height) continue;
        const ivec2 R = ivec2(1, 0), D = ivec2(0, 1);
        int place = first + x.y * width + x.x;
        vec4 links = links_at(place, x, width);
        vec4 around = vec4(other_at(x + R), other_at(x - R), other_at(x + D), other_at(x - D));
        float before = FIRST ? coarse_at(x) : steps[place];
        steps[place] = relaxed(before, equations[place].xy, links, around, over_relaxation);
    }
}
