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
layout(constant_id = 2) const bool FIRST = false;               // first relaxation sweep: dV is zero, while red is relaxed that of black too
layout(push_constant) uniform Constants {
    int width, height;
    int color;                                                  // 0 red: x + y even
    int rows;                                                   // lines per invocation
    float over_relaxation;
};

float other_at(int h, int y) {
    // Weights across the border are zero; the index only has to exist.
    return imageLoad(other, ivec3(clamp(h, 0, (width - 1) / 2), clamp(y, 0, height - 1), 0)).r;
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.x, rows * gl_GlobalInvocationID.y);
    if (2 * h.x >= width || h.y >= height) return;
    bool alone = FIRST && color == 0;
    float above = 0.0, here = 0.0, below = 0.0;
    if (!alone) {
        here = other_at(h.x, h.y - 1);
        below = other_at(h.x, h.y);
    }
    for (int n = 0; n < rows; n++, h.y++) {
        int odd = h.y + color & 1;
        ivec3 place = ivec3(h.x, min(h.y, height - 1), color);
        float target = imageLoad(right_sides, place).r;
        if (!alone) {
            above = here;
            here = below;
            below = other_at(h.x, h.y + 1);
            float side = other_at(h.x + 2 * odd - 1, h.y);
            vec4 around = vec4(odd == 1 ? side : here, odd == 1 ? here : side, below, above);
            target += dot(imageLoad(weights, place), around);
        }
        float before = FIRST ? 0.0 : imageLoad(own, ivec3(place.xy, 0)).r;
        // Also the pixel beyond an odd width: its neighbour reads it, with a weight of zero.
        if (h.y < height)
            imageStore(own, ivec3(h, 0), vec4(mix(before, target, over_relaxation)));
    }
}
