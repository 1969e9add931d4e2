#version 460
// Refines cubic B-splines on every other pixel to those on every pixel, a layer for each workgroup along z, or
// both photographs if they are packed. CPU reference: src/engine/stages/subdivide.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32ui) uniform readonly uimage2DArray coarse;
layout(binding = 1, r32ui) uniform writeonly uimage2DArray fine;
layout(binding = 2, std430) readonly buffer Tiles { uint tiles[]; };
layout(push_constant) uniform Constants {
    int width, height;   // of the fine image
    int from_layer;      // of the coarse image, the first
    int from_step;       // from there to the next
    int layer;           // of the fine image, for the first layer of the coarse one
    int step;            // from there to the next
    int planes;          // layers
    int listed;          // first entry of the list of tiles
};

#include "tiles.glsl"
#include "stacks.glsl"

// Of both photographs, if they are packed; else of one.
vec2 coefficients(int x, int y) {
    uint texel = imageLoad(coarse, ivec3(x, y, from_layer + int(gl_WorkGroupID.z) * from_step)).r;
    return PACKED ? vec2(unpacked(texel, 1), unpacked(texel, 2)) : vec2(uintBitsToFloat(texel));
}

void store(ivec2 x, int target, vec2 value) {
    uint texel = PACKED ? packed_texel(value.x, value.y) : floatBitsToUint(value.x);
    imageStore(fine, ivec3(x, target), uvec4(texel));
}

void main() {
    ivec2 size = ivec2(width, height), i = invocation(tile_at(listed), gl_WorkGroupSize.xy), pixel = 2 * i;
    int target = layer + int(gl_WorkGroupID.z) * step;
    if (pixel.x >= width || pixel.y >= height) return;
    // Mirrored about the border pixels of the fine image.
    ivec2 before = min(abs(i - 1), max(size - 2, 0)), after = max(min(i + 1, size - 2 - i), 0);
    mat3x2 row[3];
    int ys[3] = int[](before.y, i.y, after.y);
    for (int n = 0; n < 3; n++)
        row[n] = mat3x2(coefficients(before.x, ys[n]), coefficients(i.x, ys[n]), coefficients(after.x, ys[n]));
    mat3x2 on = 0.125 * (row[0] + row[2]) + 0.75 * row[1], below = 0.5 * (row[1] + row[2]);
    const vec3 ON = vec3(0.125, 0.75, 0.125), BESIDE = vec3(0.0, 0.5, 0.5);
    store(pixel, target, on * ON);
    bool right = pixel.x + 1 < width, down = pixel.y + 1 < height;
    if (right) store(pixel + ivec2(1, 0), target, on * BESIDE);
    if (down) store(pixel + ivec2(0, 1), target, below * ON);
    if (right && down) store(pixel + 1, target, below * BESIDE);
}
