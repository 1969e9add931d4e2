#version 460
// Blurs both images until they look alike, on every other pixel along x and y: for the exposure. CPU reference:
// src/engine/stages/blur_matched_pair.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a kernel without a mean.
layout(constant_id = 3) const bool WARPED = false;

#include "blur.glsl"
#include "mask.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 2, r32ui) uniform readonly uimage2DArray stacks;   // of I1, then of I2; or coefficients of I2 alone
layout(binding = 3, r32f) uniform writeonly image2DArray pair;      // half the size: I1 and I2 times the share; share
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(binding = 5, r32f) uniform readonly image2DArray masks;          // of I1, of I2
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;                       // of the stacks; 0: no stacks yet, and V is zero
    int second_stack;                // its first layer
    float factor;                    // pixels of the full-size image per pixel of this level
    float centre[2];
    float mean[2];                   // of the kernel at variance 1
};

#include "pair.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

// I1 and I2.
vec2 images_at(ivec2 x, vec2 d, Variances of) {
    if (nodes == 0) {
        ivec2 i;
        vec2 f;
        place(x, d, ivec2(width, height), i, f);
        return vec2(imageLoad(image1, ivec3(x, 0)).r, spline_at(2, 0, ivec2(width, height), i, f).value);
    }
    PairSample both = sample_pair(x, d, of, factor);
    return vec2(both.first.value, both.second.value);
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy), x = 2 * h, size = ivec2(width, height);
    if (x.x >= width || x.y >= height) return;
    Registration r = state.registration;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r, share = 0.0;
    vec2 d = displacement_of(r, state.parallax, vec2(x), v, factor, vec2(centre[0], centre[1])), images = vec2(0.0);
    Variances of = variances_at(v, state.separation / (factor * factor));
    if (nodes == 0) of = Variances(0.0, 0.0, 0.0, 0.0);
    if (inside(x, d, size, of, scale_of(r))) {
        share = counts(x, d, size);
        images = images_at(x, d, of);
    }
    imageStore(pair, ivec3(h, 0), vec4(share * images.x));
    imageStore(pair, ivec3(h, 1), vec4(share * images.y));
    imageStore(pair, ivec3(h, 2), vec4(share));
}
