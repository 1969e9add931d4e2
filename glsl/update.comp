#version 460
// V ← V + share clamp(dV), and the count of the pixels that still move or are at the limit. A whole step may be kept,
// and the next one extrapolated from it. CPU reference: src/engine/stages/update.rs.

#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray red;
layout(binding = 1, r32f) uniform readonly image2DArray black;
layout(binding = 2, r32f) uniform image2DArray relative_blur;
layout(binding = 3, r32f) uniform readonly image2DArray normal_equations; // D, averaged over a window
layout(binding = 4, std430) buffer StateBuffer { State state; };
layout(binding = 5, r32f) uniform image2DArray kept; // layer KEPT: the sums of a whole step over blocks of 2 x 2 pixels
layout(push_constant) uniform Constants {
    int width, height;
    float largest_step;                  // px² of the level, or
    float relative_step;                 // a share of |V|, if that is more
    float limit;                         // px² of the level
    float share;                         // of dV that is added
    int extrapolation;                   // KEEP, EXTRAPOLATE, or 0
};

#include "update.glsl"

void main() {
    ivec2 first = 2 * ivec2(gl_GlobalInvocationID.xy);
    float change[4];
    [[unroll]] for (int n = 0; n < 4; n++) {
        ivec2 x = min(first + ivec2(n % 2, n / 2), ivec2(width, height) - 1);
        ivec3 h = ivec3(x.x / 2, x.y, 0);
        change[n] = (x.x + x.y & 1) == 0 ? imageLoad(red, h).r : imageLoad(black, h).r;
    }
    count(update_block(first, change, load_block(first), true));
}
