#version 460
// Determines which pixels of a photograph count: neither masked nor clipped ones, and counts the clipped ones. CPU
// reference: src/engine/stages/mask.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

#include "samples.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Samples { uint samples[]; };
layout(binding = 1, std430) readonly buffer Mask { uint mask[]; };  // a byte per pixel of I1: 0 where it does not count
layout(binding = 2, r32f) uniform writeonly image2DArray counts; // 1 where a pixel counts, in the layer of the photograph
layout(binding = 3, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    uint width, height;
    uint channels;                   // 1 or 3, interleaved
    uint bytes;                      // 1, 2 or 4 per sample
    uint second;                     // 1 for I2, which has no mask of its own
    float clipped[2];                // black and white: stored values at which a sample is clipped
};

uint sample_word(uint n) {
    return samples[n];
}

void main() {
    uvec2 x = gl_GlobalInvocationID.xy;
    uint counted = 0;
    if (x.x < width && x.y < height) {
        uint pixel = x.y * width + x.x;
        bool all_black = true, any_white = false;
        for (uint c = 0; c < channels; c++) {
            float value = stored(pixel * channels + c, bytes);
            all_black = all_black && value <= clipped[0];
            any_white = any_white || value >= clipped[1];
        }
        bool is_clipped = all_black || any_white, masked = (mask[pixel / 4] >> 8 * (pixel & 3) & 0xffu) == 0u;
        imageStore(counts, ivec3(x, second), vec4(is_clipped || masked && second == 0u ? 0.0 : 1.0));
        counted = uint(is_clipped && !masked);
    }
    uint sum = subgroupAdd(counted);
    if (subgroupElect() && sum > 0) atomicAdd(state.clipped[second], sum);
}
