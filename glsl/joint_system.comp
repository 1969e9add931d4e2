#version 460
// The linear system for du of a sweep, of what all its pairs say and of the smoothness; and how c would step. Twin:
// src/engine/stages/joint_system.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray focus;
layout(binding = 1, r32f) uniform readonly image2DArray system;         // D, b, q, over a window
layout(binding = 2, r32f) uniform writeonly image2DArray right_sides;
layout(binding = 3, rgba32f) uniform writeonly image2DArray weights;
layout(binding = 4, std430) writeonly buffer Partials { float partials[]; };
layout(push_constant) uniform Constants {
    int width, height;
    float alpha;
    float rate;                      // c, px² of the level
    float smoothness_eta;            // pixels of blur a pixel
};

const int SUMS = 2;                  // q b, q², over D and what the smoothness adds to it
shared vec2 by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4];

float focus_at(ivec2 x) { return imageLoad(focus, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r; }

float inverse_gradient(ivec2 x) {
    x = clamp(x, ivec2(0), ivec2(width, height) - 1);
    vec2 rise = 0.5 * vec2(focus_at(x + ivec2(1, 0)) - focus_at(x - ivec2(1, 0)), focus_at(x + ivec2(0, 1)) - focus_at(x - ivec2(0, 1)));
    return inversesqrt(rate * dot(rise, rise) + smoothness_eta * smoothness_eta);
}

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    vec2 sums = vec2(0.0);
    if (x.x < width && x.y < height) {
        float u = focus_at(x), phi = inverse_gradient(x);
        const ivec2 BESIDE[4] = ivec2[](ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1));
        vec4 a;
        float pull = 0.0;
        for (int n = 0; n < 4; n++) {
            ivec2 y = x + BESIDE[n];
            bool exists = all(greaterThanEqual(y, ivec2(0))) && y.x < width && y.y < height;
            a[n] = exists ? 0.5 * alpha * rate * (phi + inverse_gradient(y)) : 0.0;
            pull += a[n] * (focus_at(y) - u);
        }
        float d = imageLoad(system, ivec3(x, 0)).r, b = imageLoad(system, ivec3(x, 1)).r, q = imageLoad(system, ivec3(x, 2)).r;
        float whole = max(d + a.x + a.y + a.z + a.w, 1e-12);
        sums = q / whole * vec2(b, q);
        ivec3 at = ivec3(x.x / 2, x.y, (x.x + x.y) % 2);
        imageStore(right_sides, at, vec4((b + pull) / whole));
        imageStore(weights, at, a / whole);
    }
    vec2 sum = subgroupAdd(sums);
    if (subgroupElect()) by_subgroup[gl_SubgroupID] = sum;
    barrier();
    if (gl_LocalInvocationIndex != 0) return;
    sum = vec2(0.0);
    for (uint group = 0; group < gl_NumSubgroups; group++) sum += by_subgroup[group];
    uint row = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    partials[SUMS * row] = sum.x;
    partials[SUMS * row + 1] = sum.y;
}
