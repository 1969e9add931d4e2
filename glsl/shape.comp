#version 460
// Applies the kernel's shape to the nodes of Gaussians' blur stacks, in place; each workgroup along z to one, or
// to both if they are packed. CPU reference: src/engine/stages/shape.rs.

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
};

ivec3 place(ivec2 x, int k) { return ivec3(x, first + int(gl_WorkGroupID.z) * step + k); }

// Of both photographs, if they are packed; else of one.
vec2 node(ivec2 x, int k) {
    uint texel = imageLoad(stacks, place(x, k)).r;
    return PACKED ? vec2(unpacked(texel, 1), unpacked(texel, 2)) : vec2(uintBitsToFloat(texel));
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    float shape = state.kernel_shape;
    if (x.x >= width || x.y >= height || shape == 0.0) return;
    vec3 variances = vec3(node_variance(0), node_variance(1), node_variance(2));
    mat3x2 values = mat3x2(node(x, 0), node(x, 1), node(x, 2));
    for (int k = 1; k < nodes; k++) {
        if (k > 1 && k + 1 < nodes) {
            variances = vec3(variances.yz, node_variance(k + 1));
            values = mat3x2(values[1], values[2], node(x, k + 1));
        }
        bool last = k + 1 == nodes;
        float v = last ? variances.z : variances.y;
        vec2 value = last ? values[2] : values[1];
        mat2x3 of = transpose(values);
        value += shape * vec2(departure(v, variances, of[0]), departure(v, variances, of[1]));
        uint texel = PACKED ? packed_texel(value.x, value.y) : floatBitsToUint(value.x);
        imageStore(stacks, place(x, k), uvec4(texel));
    }
}
