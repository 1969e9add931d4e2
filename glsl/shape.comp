#version 460
// Turns the nodes of Gaussians' blur stacks into those of disks, in place; each workgroup along z one, or both if they
// are packed. CPU reference: src/engine/stages/shape.rs.

#include "state.glsl"
#include "nodes.glsl"
#include "stacks.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32ui) uniform uimage2DArray stacks;
layout(binding = 1, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    int first, step;                 // layer of the first stack, and from a stack to the next
    int planes;                      // stacks: workgroups along z, unless they are packed
    uint are_gaussian;               // 1: they are Gaussians' if the kernel is a disk; 0: only if it has just become one
};

ivec3 place(ivec2 x, int k) { return ivec3(x, first + int(gl_WorkGroupID.z) * step + k); }

// Of both photographs, if they are packed; else of one.
vec2 node(ivec2 x, int k) {
    uint texel = imageLoad(stacks, place(x, k)).r;
    return PACKED ? vec2(unpacked(texel, 1), unpacked(texel, 2)) : vec2(uintBitsToFloat(texel));
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    bool is_shaped = are_gaussian != 0u ? state.kernel_shape != 0.0 : state.becomes_disk != 0u;
    if (x.x >= width || x.y >= height || !is_shaped) return;
    // Nodes k - 2 to k + 2. What is beyond the first and the last one has no weight.
    vec2 values[DEPARTURE_NODES] = vec2[](vec2(0.0), vec2(0.0), node(x, 0), node(x, 1), node(x, 2));
    for (int k = 1; k < nodes; k++) {
        for (int n = 0; n + 1 < DEPARTURE_NODES; n++) values[n] = values[n + 1];
        if (k + 2 < nodes) values[4] = node(x, k + 2);
        vec2 value = values[2];
        int row = departure_row(k, nodes);
        for (int n = 0; n < DEPARTURE_NODES; n++) value += DEPARTURES[row + n] * values[n];
        uint texel = PACKED ? packed_texel(value.x, value.y) : floatBitsToUint(value.x);
        imageStore(stacks, place(x, k), uvec4(texel));
    }
}
