#version 460
// V and its standard deviation on a coarser level, for the search for outlines there. CPU reference:
// src/engine/stages/edge_coarsen.rs.

#include "nan.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32f) uniform writeonly image2DArray coarse;
layout(binding = 2, r32f) uniform image2DArray results;   // layers: the standard deviation; that of the coarser level
#include "edge_levels.glsl"

#include "edge.glsl"

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy), last = ivec2(finest[0], finest[1]) - 1;
    if (x.x >= width || x.y >= height) return;
    vec2 sums = vec2(0.0), weights = vec2(0.0);
    for (int j = 1 - pixels; j < pixels; j++) {
        for (int i = 1 - pixels; i < pixels; i++) {
            ivec2 at = clamp(pixels * x + apart * ivec2(i, j), ivec2(0), last);
            float weight = float((pixels - abs(i)) * (pixels - abs(j)));
            float deviation = imageLoad(results, ivec3(at, 1)).r;
            bool known = !isnan(deviation);
            sums += weight * vec2(imageLoad(relative_blur, ivec3(at, 0)).r, known ? deviation : 0.0);
            weights += weight * vec2(1.0, known);
        }
    }
    const float NONE = uintBitsToFloat(0x7fc00000u);
    imageStore(coarse, ivec3(x, 0), vec4(scale * sums.x / weights.x));
    imageStore(results, ivec3(x, COARSE_DEVIATION), vec4(weights.y > 0.0 ? scale * sums.y / weights.y : NONE));
}
