#version 460
// What the rows of partial sums add up to, for the host to judge T's motion model by. One workgroup. Twin:
// src/engine/stages/totals.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) writeonly buffer Totals { float result[]; };
layout(push_constant) uniform Constants {
    int rows;                        // of partial sums
};

#include "add_up.glsl"

void main() {
    add_up(rows);
    int n = int(gl_LocalInvocationIndex);
    if (n < SUMS) result[n] = totals[n];
}
