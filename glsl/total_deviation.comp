#version 460
// Adds to the standard deviation of V the correlation of neighbouring residuals, and the deviation of V's scale.
// CPU reference: src/engine/stages/total_deviation.rs.

#include "nan.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray terms;   // on every other pixel: means of C, b², (∇²V)², b Σb
layout(binding = 1, r32f) uniform image2DArray results;          // layers: V, its standard deviation
layout(binding = 2, std430) readonly buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int width, height;
    float pixels;                    // pixels of a window
    float largest;                   // standard deviation, px²
};

#include "terms.glsl"

void main() {
    ivec2 x = ivec2(gl_GlobalInvocationID.xy), size = ivec2(width, height);
    if (x.x >= width || x.y >= height) return;
    float deviation = imageLoad(results, ivec3(x, 1)).r;
    // Also false where there is no result.
    if (!(deviation < largest)) return;
    float curvature = term(0, x, size), excess = max(term(3, x, size) - term(1, x, size), 0.0);
    float alike = curvature > 0.0 ? state.correlated * excess / (pixels * curvature * curvature) : 0.0;
    float scale = state.scale_deviation * imageLoad(results, ivec3(x, 0)).r;
    imageStore(results, ivec3(x, 1), vec4(min(sqrt(deviation * deviation + alike + scale * scale), largest)));
}
