#version 460
// Brings what the search for outlines changed on a coarser level to the finest one. CPU reference:
// src/engine/stages/edge_refine.rs.

#include "nan.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray coarse;   // V of the near side at outlines of the coarser level
layout(binding = 1, r32f) uniform image2DArray relative_blur;
// Layers: V, its standard deviation; sides; of the coarser level the deviation, V of the far side, and the others near
// outlines.
layout(binding = 2, r32f) uniform image2DArray results;
#include "edge_levels.glsl"

#include "edge.glsl"

// A number at four neighbours.
vec4 four(int layer, ivec2 low, ivec2 high) {
    return vec4(imageLoad(results, ivec3(low, layer)).r, imageLoad(results, ivec3(high.x, low.y, layer)).r,
                imageLoad(results, ivec3(low.x, high.y, layer)).r, imageLoad(results, ivec3(high, layer)).r);
}

void main() {
    ivec2 low = ivec2(gl_GlobalInvocationID.xy);
    if (low.x >= width || low.y >= height) return;
    ivec2 high = min(low + 1, ivec2(width, height) - 1);
    vec4 shares = four(COARSE_SHARE, low, high);
    if (shares == vec4(0.0)) return;
    // Where nothing changes, the others may be NaN.
    bvec4 changes = notEqual(shares, vec4(0.0));
    vec4 probabilities = mix(vec4(0.0), four(COARSE_NEAR, low, high), changes);
    vec4 distances = mix(vec4(0.0), four(COARSE_TOWARDS_NEAR, low, high), changes);
    vec4 nears = vec4(imageLoad(coarse, ivec3(low, 0)).r, imageLoad(coarse, ivec3(high.x, low.y, 0)).r,
                      imageLoad(coarse, ivec3(low.x, high.y, 0)).r, imageLoad(coarse, ivec3(high, 0)).r);
    nears = mix(vec4(0.0), nears, changes) / scale;
    vec4 fars = mix(vec4(0.0), four(COARSE_FAR, low, high), changes) / scale;
    vec4 deviations = mix(vec4(0.0), four(COARSE_DEVIATION, low, high), changes) / scale;
    for (int n = 0; n < pixels * pixels; n++) {
        ivec2 step = ivec2(n % pixels, n / pixels), x = pixels * low + step;
        if (x.x >= finest[0] || x.y >= finest[1]) continue;
        vec2 f = vec2(step) / float(pixels);
        vec4 places = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
        float share = dot(places, abs(shares)), deviation = imageLoad(results, ivec3(x, 1)).r;
        if (share == 0.0) continue;
        // Where there are no results, the deviation is NaN.
        if (isnan(deviation)) continue;
        vec4 weights = mix(vec4(0.0), places, changes);
        weights /= dot(weights, vec4(1.0));
        float near = dot(weights, nears), far = dot(weights, fars);
        float p = dot(weights, probabilities), shown = shown_near(p);
        float mixed = deviation_between(p, shown) * abs(near - far) + dot(weights, deviations);
        float front = dot(places, shares) > 0.0 ? near : far;
        share *= change(dot(weights, distances), shown);
        float v = mix(imageLoad(relative_blur, ivec3(x, 0)).r, mix(far, near, shown), share);
        imageStore(relative_blur, ivec3(x, 0), vec4(v));
        imageStore(results, ivec3(x, 0), vec4(v));
        imageStore(results, ivec3(x, 1), vec4(mix(deviation, mixed, share)));
        if (near * far < 0.0) imageStore(results, ivec3(x, SIDES), vec4(v * front > 0.0 ? abs(front) : -abs(front)));
    }
}
