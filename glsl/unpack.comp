#version 460
// A frame as a camera packs it to samples one behind the other, of grey or of red, green and blue. Twin: src/engine/stages/unpack.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Packed { uint packed_words[]; };
layout(binding = 1, std430) writeonly buffer Samples { uint samples[]; };
layout(push_constant) uniform Constants {
    uint width, height;
    uint bits;                       // of a packed sample
    uint packing;                    // 0: in bytes of their own, 1: bit behind bit, 2: two in three bytes
    uint count;                      // packed samples a pixel
    uint reversed;                   // 1: blue comes first
    uint is_mosaic;                  // 1: a sample is of a colour by its place
    uint red_x, red_y;               // where red is among two by two pixels
    uint row;                        // words of the samples that a row of invocations writes
};

uint packed_byte(uint at) {
    return packed_words[at >> 2] >> 8 * (at & 3) & 0xffu;
}

uint bits_of(uint i) {
    uint first = i * bits, word = first >> 5, shift = first & 31;
    uint low = packed_words[word] >> shift;
    return shift + bits > 32 ? low | packed_words[word + 1] << 32 - shift : low;
}

uint half_of_pair(uint i) {
    uint at = i / 2 * 3, low_bits = bits - 8;
    bool is_first = (i & 1) == 0;
    uint high = packed_byte(is_first ? at : at + 2), low = packed_byte(at + 1) >> (is_first ? 0 : 4);
    return high << low_bits | low & (1u << low_bits) - 1;
}

uint packed_sample(uint i) {
    if (packing == 1) return bits_of(i);
    if (packing == 2) return half_of_pair(i);
    return bits == 8 ? packed_byte(i) : packed_words[i >> 1] >> 16 * (i & 1) & 0xffffu;
}

// Packed sample i, of 8 bits or widened to 16.
uint widened(uint i) {
    uint most = (1u << bits) - 1;
    uint value = packed_sample(i) & most;
    return bits == 8 ? value : (value * 65535 + most / 2) / most;
}

int mosaic_sample(ivec2 x) {
    ivec2 last = ivec2(width, height) - 1;
    x = max(min(abs(x), 2 * last - abs(x)), 0);
    return int(widened(uint(x.y) * width + uint(x.x)));
}

int across(ivec2 x, int d) {
    return mosaic_sample(x + ivec2(-d, 0)) + mosaic_sample(x + ivec2(d, 0));
}

int along(ivec2 x, int d) {
    return mosaic_sample(x + ivec2(0, -d)) + mosaic_sample(x + ivec2(0, d));
}

int corners(ivec2 x) {
    return across(x + ivec2(0, -1), 1) + across(x + ivec2(0, 1), 1);
}

// A colour of a pixel, by the linear filters of Malvar, He and Cutler, ICASSP 2004, in sixteenths.
uint mosaic_color(ivec2 x, uint channel) {
    bool in_row = (x.y & 1) == red_y, is_green = ((x.x & 1) == red_x) != in_row, is_near = in_row == (channel == 0);
    int here = mosaic_sample(x), sum;
    if (channel == 1) {
        sum = is_green ? 16 * here : 8 * here + 4 * (across(x, 1) + along(x, 1)) - 2 * (across(x, 2) + along(x, 2));
    } else if (is_green) {
        int between = is_near ? 8 * across(x, 1) - 2 * across(x, 2) + along(x, 2)
                              : 8 * along(x, 1) - 2 * along(x, 2) + across(x, 2);
        sum = 10 * here - 2 * corners(x) + between;
    } else {
        sum = is_near ? 16 * here : 12 * here + 4 * corners(x) - 3 * (across(x, 2) + along(x, 2));
    }
    return uint(clamp((sum + 8) >> 4, 0, bits == 8 ? 255 : 65535));
}

// Sample i of what is written.
uint sample_value(uint i) {
    if (is_mosaic == 1) {
        uint pixel = i / 3;
        return mosaic_color(ivec2(pixel % width, pixel / width), i % 3);
    }
    if (count == 1) return widened(i);
    uint channel = i % 3;
    return widened(i / 3 * count + (reversed == 1 ? 2 - channel : channel));
}

// An invocation writes a word, four samples or two.
void main() {
    uint word = gl_GlobalInvocationID.y * row + gl_GlobalInvocationID.x;
    uint a_word = bits == 8 ? 4 : 2, all = width * height * (count == 1 && is_mosaic == 0 ? 1 : 3);
    if (gl_GlobalInvocationID.x >= row || word * a_word >= all) return;
    uint value = 0;
    for (uint n = 0; n < a_word && word * a_word + n < all; n++) {
        value |= sample_value(word * a_word + n) << n * (32 / a_word);
    }
    samples[word] = value;
}
