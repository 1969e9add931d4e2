#version 460
// V ← V + share clamp(dV), and the count of the pixels that still move. CPU reference: src/engine/stages/update.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

#include "state.glsl"

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray red;
layout(binding = 1, r32f) uniform readonly image2DArray black;
layout(binding = 2, r32f) uniform image2DArray relative_blur;
layout(binding = 3, r32f) uniform readonly image2DArray normal_equations; // D, averaged over a window
layout(binding = 4, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    float largest_step;                  // px² of the level, or
    float relative_step;                 // a share of |V|, if that is more
    float limit;                         // px² of the level
    float share;                         // of dV that is added
};

// A pixel moves if its step is more than the first share of its standard deviation, and far if more than the second.
const float STILL = 0.1, FAR = 0.5;
// Of the standard deviation: 1/(4π 4²), the window's effective pixels, and the square of its factor 1.8.
const float INDEPENDENT = 0.004973592, WIDER = 3.24;

bool moves(float change, float d, float share_of_deviation) {
    float step = share_of_deviation * share_of_deviation;
    return d * change * change > step * WIDER * INDEPENDENT * state.variance;
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    uvec2 moving = uvec2(0);
    if (x.x < width && x.y < height) {
        ivec3 h = ivec3(x.x / 2, x.y, 0);
        float change = (x.x + x.y & 1) == 0 ? imageLoad(red, h).r : imageLoad(black, h).r;
        float before = imageLoad(relative_blur, ivec3(x, 0)).r, most = max(largest_step, relative_step * abs(before));
        change = clamp(change, -most, most);
        imageStore(relative_blur, ivec3(x, 0), vec4(clamp(before + share * change, -limit, limit)));
        float whole = clamp(before + change, -limit, limit) - before;
        float d = imageLoad(normal_equations, ivec3(x, 0)).r;
        moving = uvec2(moves(whole, d, STILL), moves(whole, d, FAR));
    }
    uvec2 sum = subgroupAdd(moving);
    if (!subgroupElect()) return;
    if (sum.x > 0) atomicAdd(state.moving, sum.x);
    if (sum.y > 0) atomicAdd(state.moving_far, sum.y);
}
