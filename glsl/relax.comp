#version 460
// Half a relaxation sweep on the linear system for dV: the red or the black pixels. CPU reference:
// src/engine/stages/relax.rs.
//
// dV is bound twice, to be read and to be written, so that validation reports a missing barrier. An invocation goes down
// a column: two of four neighbours are loaded already.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray smoothed;    // layer RIGHT_SIDE
layout(binding = 1, rgba16f) uniform readonly image2DArray weights;  // by color; right, left, down, up
layout(binding = 2, std430) readonly buffer Steps { float steps[]; }; // dV of the first coarse grid, and of the level
layout(binding = 3, std430) writeonly buffer OwnSteps { float own_steps[]; }; // the same buffer
layout(constant_id = 2) const bool FIRST = false;               // first relaxation sweep: starts from the coarse grid
layout(push_constant) uniform Constants {
    int width, height;
    int color;                                                  // 0 red: x + y even
    int rows;                                                   // lines per invocation
    float over_relaxation;
    int first;                                                  // place of dV of the level
};

const int RIGHT_SIDE = 1;            // the layer of the right sides

// dV at pixel h of a color; 0 beyond an odd width.
float step_at(int h, int y, int color, bool is_coarse) {
    int x = 2 * h + (y + color & 1);
    if (x >= width) return 0.0;
    return is_coarse ? steps[y / 2 * ((width + 1) / 2) + x / 2] : steps[first + y * width + x];
}

float other_at(int h, int y) {
    // Weights across the border are zero; the index only has to exist.
    h = clamp(h, 0, (width - 1) / 2);
    y = clamp(y, 0, height - 1);
    // While red is relaxed for the first time black has no value yet.
    return step_at(h, y, 1 - color, FIRST && color == 0);
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.x, rows * gl_GlobalInvocationID.y);
    if (2 * h.x >= width || h.y >= height) return;
    float above = 0.0, here = other_at(h.x, h.y - 1), below = other_at(h.x, h.y);
    for (int n = 0; n < rows && h.y < height; n++, h.y++) {
        int odd = h.y + color & 1, x = 2 * h.x + odd;
        above = here;
        here = below;
        below = other_at(h.x, h.y + 1);
        if (x >= width) continue;
        float side = other_at(h.x + 2 * odd - 1, h.y);
        vec4 around = vec4(odd == 1 ? side : here, odd == 1 ? here : side, below, above);
        float right_side = imageLoad(smoothed, ivec3(x, h.y, RIGHT_SIDE)).r;
        float target = right_side + dot(imageLoad(weights, ivec3(h, color)), around);
        own_steps[first + h.y * width + x] = mix(step_at(h.x, h.y, color, FIRST), target, over_relaxation);
    }
}
