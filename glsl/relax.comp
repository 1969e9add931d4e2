#version 460
// Half a relaxation sweep on the linear system for dV: the red or the black pixels. CPU reference:
// src/engine/stages/relax.rs.
//
// Red and black are in separate half-width images, so that validation reports a missing barrier. An invocation goes
// down a column: two of four neighbours are loaded already.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray right_sides; // layer 0: red, layer 1: black
layout(binding = 1, rgba16f) uniform readonly image2DArray weights;  // likewise; right, left, down, up
layout(binding = 2, r32f) uniform readonly image2DArray other;  // dV of the other color
layout(binding = 3, r32f) uniform image2DArray own;             // dV of this color
layout(binding = 4, std430) readonly buffer GridSteps { float steps[]; };   // dV of the first coarse grid
layout(constant_id = 2) const bool FIRST = false;               // first relaxation sweep: starts from the coarse grid
layout(push_constant) uniform Constants {
    int width, height;
    int color;                                                  // 0 red: x + y even
    int rows;                                                   // lines per invocation
    float over_relaxation;
};

// dV of the coarse grid at pixel h of a color; 0 beyond an odd width.
float coarse_at(int h, int y, int color) {
    int x = 2 * h + (y + color & 1);
    return x < width ? steps[y / 2 * ((width + 1) / 2) + x / 2] : 0.0;
}

float other_at(int h, int y) {
    // Weights across the border are zero; the index only has to exist.
    h = clamp(h, 0, (width - 1) / 2);
    y = clamp(y, 0, height - 1);
    // While red is relaxed for the first time black has no value yet.
    return FIRST && color == 0 ? coarse_at(h, y, 1) : imageLoad(other, ivec3(h, y, 0)).r;
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.x, rows * gl_GlobalInvocationID.y);
    if (2 * h.x >= width || h.y >= height) return;
    float above = 0.0, here = other_at(h.x, h.y - 1), below = other_at(h.x, h.y);
    for (int n = 0; n < rows; n++, h.y++) {
        int odd = h.y + color & 1;
        ivec3 place = ivec3(h.x, min(h.y, height - 1), color);
        above = here;
        here = below;
        below = other_at(h.x, h.y + 1);
        float side = other_at(h.x + 2 * odd - 1, h.y);
        vec4 around = vec4(odd == 1 ? side : here, odd == 1 ? here : side, below, above);
        float target = imageLoad(right_sides, place).r + dot(imageLoad(weights, place), around);
        float before = FIRST ? coarse_at(place.x, place.y, color) : imageLoad(own, ivec3(place.xy, 0)).r;
        // Also the pixel beyond an odd width: its neighbour reads it, with a weight of zero.
        if (h.y < height)
            imageStore(own, ivec3(h, 0), vec4(mix(before, target, over_relaxation)));
    }
}
