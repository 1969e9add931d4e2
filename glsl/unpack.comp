#version 460
// Unpacks a frame from its camera's format to interleaved samples, grey or red, green and blue. CPU reference:
// src/engine/stages/unpack.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
// Specialization constants, since software devices execute both sides of a branch.
layout(constant_id = 2) const bool BITS = false;    // contiguous bits
layout(constant_id = 3) const bool PAIRS = false;   // two samples in three bytes
layout(constant_id = 4) const bool MOSAIC = false;  // the color of a sample depends on its place
layout(constant_id = 5) const bool WIDE = false;    // samples have more than 8 bits, and become 16
layout(binding = 0, std430) readonly buffer Packed { uint packed_words[]; };
layout(binding = 1, std430) writeonly buffer Samples { uint samples[]; };
layout(push_constant) uniform Constants {
    uint width, height;
    uint bits;                       // of a packed sample
    uint count;                      // packed samples per pixel
    uint reversed;                   // 1: the order is blue, green, red
    uint red[2];                    // place of red among two by two pixels
    uint row;                        // groups of four pixels per row of invocations
    uint steps[2];                   // quotient and remainder of 65535 by the greatest packed sample
};

uint packed_byte(uint at) {
    return packed_words[at >> 2] >> 8 * (at & 3) & 0xffu;
}

// Packed sample i, of 8 bits or widened to 16.
uint widened(uint i) {
    uint most = (1u << bits) - 1, value;
    if (BITS) {
        uint first = i * bits, word = first >> 5, shift = first & 31;
        uint low = packed_words[word] >> shift;
        value = shift + bits > 32 ? low | packed_words[word + 1] << 32 - shift : low;
    } else if (PAIRS) {
        uint at = i / 2 * 3, low_bits = bits - 8, second = i & 1;
        uint high = packed_byte(at + 2 * second), low = packed_byte(at + 1) >> 4 * second;
        value = high << low_bits | low & (1u << low_bits) - 1;
    } else {
        value = WIDE ? packed_words[i >> 1] >> 16 * (i & 1) : packed_byte(i);
    }
    value &= most;
    if (!WIDE) return value;
    // (65535 v + m/2) / m: the remainder is small enough for single precision, and never half-way, since m is odd.
    return value * steps[0] + uint(float(value * steps[1]) / float(most) + 0.5);
}

int mosaic_sample(ivec2 x) {
    ivec2 last = ivec2(width, height) - 1;
    x = max(min(abs(x), 2 * last - abs(x)), 0);
    return int(widened(uint(x.y) * width + uint(x.x)));
}

// The colors of a pixel, by the linear filters of Malvar, He and Cutler, ICASSP 2004, in sixteenths.
uvec3 mosaic_colors(ivec2 x) {
    int here = mosaic_sample(x);
    int across = mosaic_sample(x + ivec2(-1, 0)) + mosaic_sample(x + ivec2(1, 0));
    int along = mosaic_sample(x + ivec2(0, -1)) + mosaic_sample(x + ivec2(0, 1));
    int corners = mosaic_sample(x + ivec2(-1, -1)) + mosaic_sample(x + ivec2(1, -1))
                + mosaic_sample(x + ivec2(-1, 1)) + mosaic_sample(x + ivec2(1, 1));
    int across_two = mosaic_sample(x + ivec2(-2, 0)) + mosaic_sample(x + ivec2(2, 0));
    int along_two = mosaic_sample(x + ivec2(0, -2)) + mosaic_sample(x + ivec2(0, 2));
    bool in_row = (x.y & 1) == red[1], is_green = ((x.x & 1) == red[0]) != in_row;
    int in_its_row = 10 * here + 8 * across - 2 * corners - 2 * across_two + along_two;
    int in_its_column = 10 * here + 8 * along - 2 * corners - 2 * along_two + across_two;
    int opposite = 12 * here + 4 * corners - 3 * (across_two + along_two);
    // The color of the row (red's or blue's), and the other one.
    int near = is_green ? in_its_row : 16 * here, far = is_green ? in_its_column : opposite;
    int green = is_green ? 16 * here : 8 * here + 4 * (across + along) - 2 * (across_two + along_two);
    ivec3 sums = in_row ? ivec3(near, green, far) : ivec3(far, green, near);
    return uvec3(clamp((sums + 8) >> 4, 0, WIDE ? 65535 : 255));
}

uvec3 colors(uint pixel) {
    if (MOSAIC) return mosaic_colors(ivec2(pixel % width, pixel / width));
    uint first = pixel * count;
    return uvec3(widened(first + 2 * reversed), widened(first + 1), widened(first + 2 - 2 * reversed));
}

// An invocation writes four pixels, in whole words. The last group is padded with zeros.
void main() {
    uint four = gl_GlobalInvocationID.y * row + gl_GlobalInvocationID.x, first = 4 * four, all = width * height;
    if (gl_GlobalInvocationID.x >= row || first >= all) return;
    if (count == 1 && !MOSAIC) {
        uint values[4];
        for (uint n = 0; n < 4; n++) values[n] = first + n < all ? widened(first + n) : 0;
        if (WIDE) {
            samples[2 * four] = values[0] | values[1] << 16;
            if (first + 2 < all) samples[2 * four + 1] = values[2] | values[3] << 16;
        } else {
            samples[four] = values[0] | values[1] << 8 | values[2] << 16 | values[3] << 24;
        }
        return;
    }
    uvec3 c[4];
    for (uint n = 0; n < 4; n++) c[n] = first + n < all ? colors(first + n) : uvec3(0);
    uint there = 3 * min(all - first, 4);
    if (WIDE) {
        uint words[6] = {c[0].x | c[0].y << 16, c[0].z | c[1].x << 16, c[1].y | c[1].z << 16,
                         c[2].x | c[2].y << 16, c[2].z | c[3].x << 16, c[3].y | c[3].z << 16};
        for (uint n = 0; n < 6; n++) if (2 * n < there) samples[6 * four + n] = words[n];
    } else {
        uint words[3] = {c[0].x | c[0].y << 8 | c[0].z << 16 | c[1].x << 24, c[1].y | c[1].z << 8 | c[2].x << 16 | c[2].y << 24,
                         c[2].z | c[3].x << 8 | c[3].y << 16 | c[3].z << 24};
        for (uint n = 0; n < 3; n++) if (4 * n < there) samples[3 * four + n] = words[n];
    }
}
