// The tile of its image that a workgroup computes: one of all, or one from a list. Needs the buffer `tiles`.

layout(constant_id = 4) const bool LISTED = false;

// In tiles. Words of a list, which begins at `first`, hold x, and y from bit 16 on.
uvec2 tile_at(int first) {
    if (!LISTED) return gl_WorkGroupID.xy;
    uint tile = tiles[first + int(gl_WorkGroupID.x)];
    return uvec2(tile & 65535u, tile >> 16);
}

// The place of an invocation among those of all tiles of this shape.
ivec2 invocation(uvec2 tile, uvec2 shape) {
    uint n = gl_LocalInvocationIndex;
    return ivec2(shape * tile + uvec2(n % shape.x, n / shape.x));
}
