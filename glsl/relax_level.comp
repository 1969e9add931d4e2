#version 460
// All relaxation sweeps on a small level by one workgroup: there a dispatch takes longer than its work. CPU reference:
// src/engine/stages/relax_level.rs.

#extension GL_EXT_control_flow_attributes : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray right_sides; // layer 0: red, layer 1: black
layout(binding = 1, rgba16f) uniform readonly image2DArray weights;  // likewise; right, left, down, up
layout(binding = 2, r32f) uniform coherent image2DArray red;    // dV
layout(binding = 3, r32f) uniform coherent image2DArray black;
layout(binding = 4, std430) readonly buffer GridSteps { float steps[]; };   // dV of the first coarse grid
layout(push_constant) uniform Constants {
    int width, height;
    int sweeps;
    float over_relaxation;
};

float change_at(int color, int h, int y) {
    // Weights across the border are zero; the index only has to exist.
    ivec3 place = ivec3(clamp(h, 0, (width - 1) / 2), clamp(y, 0, height - 1), 0);
    return color == 0 ? imageLoad(red, place).r : imageLoad(black, place).r;
}

void store(int color, ivec2 h, float change) {
    if (color == 0) imageStore(red, ivec3(h, 0), vec4(change));
    else imageStore(black, ivec3(h, 0), vec4(change));
}

void start(int color, ivec2 h) {
    int x = 2 * h.x + (h.y + color & 1);
    store(color, h, x < width ? steps[h.y / 2 * ((width + 1) / 2) + x / 2] : 0.0);
}

void relax(int color, ivec2 h) {
    int odd = h.y + color & 1;
    ivec3 place = ivec3(h, color);
    vec4 around = vec4(change_at(1 - color, h.x + odd, h.y), change_at(1 - color, h.x + odd - 1, h.y),
                       change_at(1 - color, h.x, h.y + 1), change_at(1 - color, h.x, h.y - 1));
    float target = imageLoad(right_sides, place).r + dot(imageLoad(weights, place), around);
    store(color, h, mix(change_at(color, h.x, h.y), target, over_relaxation));
}

void main() {
    int total = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y), first = int(gl_LocalInvocationIndex);
    // Also the pixel beyond an odd width: its neighbour reads it, with a weight of zero.
    int columns = (width + 1) / 2, count = columns * height;
    for (int n = first; n < count; n += total) {
        start(0, ivec2(n % columns, n / columns));
        start(1, ivec2(n % columns, n / columns));
    }
    memoryBarrierImage();
    barrier();
    for (int sweep = 0; sweep < sweeps; sweep++) {
        [[unroll]] for (int color = 0; color < 2; color++) {
            for (int n = first; n < count; n += total) relax(color, ivec2(n % columns, n / columns));
            memoryBarrierImage();
            barrier();
        }
    }
}
