#version 460
// Converts samples of a photograph to one channel, in units, and measures white. CPU reference:
// src/engine/stages/ingest.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

#include "samples.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Samples { uint samples[]; };
layout(binding = 1, r32f) uniform writeonly image2DArray image;
layout(binding = 2, std430) buffer StateBuffer { State state; };
layout(constant_id = 2) const bool SRGB = false;    // decodes the sRGB curve
layout(constant_id = 3) const bool MEASURES = false; // raises white to the largest magnitude
layout(constant_id = 5) const bool IN_UNITS = false;
layout(push_constant) uniform Constants {
    uint width, height;
    uint channels;                   // 1 or 3, interleaved
    uint bytes;                      // 1, 2 or 4 per sample
    float weights[3];                // of red, green and blue; unused for one channel
};

uint sample_word(uint n) {
    return samples[n];
}

shared uint largest;

void main() {
    uvec2 x = gl_GlobalInvocationID.xy;
    bool exists = x.x < width && x.y < height;
    float value = exists ? intensity(x.y * width + x.x, channels, bytes, vec3(weights[0], weights[1], weights[2]), SRGB) : 0.0;
    if (IN_UNITS) value *= reciprocal(state.unit);
    if (exists) imageStore(image, ivec3(x, 0), vec4(value));
    if (!MEASURES) return;
    if (gl_LocalInvocationIndex == 0) largest = 0u;
    barrier();
    float most = subgroupMax(abs(value));
    if (subgroupElect()) atomicMax(largest, floatBitsToUint(most));
    barrier();
    if (gl_LocalInvocationIndex == 0) atomicMax(state.white, largest);
}
