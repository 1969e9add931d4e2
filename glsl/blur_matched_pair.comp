#version 460
// Blurs the sharper image by V so that both look alike, on every other pixel along x and y: for the exposure. CPU
// reference: src/engine/stages/blur_matched_pair.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// The stack of I2 is of I2 as warped onto I1's pixels, and of a Gaussian.
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
    float mean[2];                   // of the kernel at V = 1
};

#include "coefficients.glsl"

float mask_at(int image, ivec2 x) {
    return imageLoad(masks, ivec3(x, image - 1)).r;
}

// I1 and I2.
vec2 images_at(ivec2 x, vec2 d, float v) {
    Registration r = state.registration;
    ivec2 size = ivec2(width, height);
    vec2 centre = vec2(centre[0], centre[1]);
    float i1 = imageLoad(image1, ivec3(x, 0)).r;
    if (nodes == 0) {
        ivec2 i;
        vec2 f;
        place(x, d, size, i, f);
        return vec2(i1, spline_at(2, 0, size, i, f).value);
    }
    Blur blur = Blur(size, nodes, vec2(mean[0], mean[1]));
    PairSample both;
    if (WARPED) {
        ivec3 columns = ivec3(reflect_once(ivec2(x.x - 1, x.x), size.xx), reflect_once(ivec2(x.x + 1), size.xx).x);
        ivec3 lines = ivec3(reflect_once(ivec2(x.y - 1, x.y), size.yy), reflect_once(ivec2(x.y + 1), size.yy).x);
        vec2 shift = displacement(moved_since(state.warped, r), x, factor, centre);
        both = blur_near(blur, v, shift, stencil(1, 0, columns, lines), stencil(2, 0, columns, lines), columns, lines);
    } else {
        both = blur_apart(blur, r, x, v, d, scale_of(r), i1);
    }
    return v >= 0.0 ? vec2(both.b1.value, both.j.value) : vec2(i1, both.b2.value);
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy), x = 2 * h, size = ivec2(width, height);
    if (x.x >= width || x.y >= height) return;
    Registration r = state.registration;
    float v = imageLoad(relative_blur, ivec3(x, 0)).r, share = 0.0;
    vec2 d = displacement(r, x, factor, vec2(centre[0], centre[1])), images = vec2(0.0);
    if (inside(x, d, size, v, scale_of(r))) {
        share = counts(x, d, size);
        images = images_at(x, d, v);
    }
    imageStore(pair, ivec3(h, 0), vec4(share * images.x));
    imageStore(pair, ivec3(h, 1), vec4(share * images.y));
    imageStore(pair, ivec3(h, 2), vec4(share));
}
