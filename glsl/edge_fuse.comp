#version 460
// One channel of the fused image behind a depth edge, without the light of what is in front. CPU reference:
// src/engine/stages/edge_fuse.rs.

#include "nan.glsl"
#include "spline.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray channel1;
layout(binding = 1, r32f) uniform readonly image2DArray spline2;       // coefficients of the channel of I2
layout(binding = 2, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 3, r32f) uniform image2DArray results;
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    int layer;                       // of the channel
    float centre[2];
};

#include "edge.glsl"
#include "fuse.glsl"

// The least share of what is behind that a pixel's light is divided by: that at a straight rim.
const float LEAST_SHARE = 0.5;
// Samples of the front's blur over its σ.
const float SAMPLES = 4.0;
// How far the result may be beyond what the other photograph shows there, as a share of the difference of both: room
// for the texture that is blurred there. Where an outline is a pixel too far out, more than the front's light is
// subtracted.
const float MOST_BEYOND = 0.5;

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy);
    if (x.x >= width || x.y >= height) return;
    float variance = -imageLoad(results, ivec3(x, SIDES)).r;
    if (!(variance > 0.0)) return;
    // A quarter of σ apart, rounded up: 25 x 25 samples at most.
    int apart_by = max(int(ceil(sqrt(variance) / SAMPLES)), 1), reach = int(ceil(3.0 * sqrt(variance)));
    ivec2 before = min(x, ivec2(reach)) / apart_by, after = min(ivec2(width, height) - 1 - x, ivec2(reach)) / apart_by;
    float sum = 0.0, in_front = 0.0, light = 0.0;
    for (int j = x.y - before.y * apart_by; j <= x.y + after.y * apart_by; j += apart_by) {
        for (int i = x.x - before.x * apart_by; i <= x.x + after.x * apart_by; i += apart_by) {
            vec2 apart = vec2(i, j) - vec2(x);
            float weight = exp(-dot(apart, apart) / (2.0 * variance));
            sum += weight;
            if (!(imageLoad(results, ivec3(i, j, SIDES)).r > 0.0)) continue;
            in_front += weight;
            light += weight * imageLoad(results, ivec3(i, j, layer)).r;
        }
    }
    if (in_front == 0.0) return;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r;
    vec2 photographs = photographs_at(x, v);
    float fused = imageLoad(results, ivec3(x, layer)).r, behind = (fused - light / sum) / max(1.0 - in_front / sum, LEAST_SHARE);
    // The photograph in which the front is sharp shows what is behind without it, but blurred.
    float blurred = v < 0.0 ? photographs.x : photographs.y;
    float most = MOST_BEYOND * abs(fused - blurred);
    behind = clamp(behind, min(fused, blurred - most), max(fused, blurred + most));
    imageStore(results, ivec3(x, layer), vec4(behind));
}
