#version 460
// Samples as the sensor gave them to one channel in [0, 1]. Twin: src/stages/ingest.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Samples { uint samples[]; };
layout(binding = 1, r32f) uniform writeonly image2DArray image;
layout(constant_id = 2) const bool SRGB = false;    // the sRGB curve is undone
layout(push_constant) uniform Constants {
    uint width, height, channels, bytes;
    float red, green, blue;
};

float sample_value(uint i) {
    uint word = samples[i * bytes >> 2];
    uint shift = 8 * (i * bytes & 3);
    float value = bytes == 1 ? float(word >> shift & 0xffu) / 255.0
                : bytes == 2 ? float(word >> shift & 0xffffu) / 65535.0
                : uintBitsToFloat(word);
    if (!SRGB) return value;
    return value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4);
}

void main() {
    uvec2 x = gl_GlobalInvocationID.xy;
    if (x.x >= width || x.y >= height) return;
    uint first = (x.y * width + x.x) * channels;
    float value = 0.0;
    // A loop, since a software device takes both sides of a branch.
    for (uint c = 0; c < channels; c++) {
        float weight = channels == 1 ? 1.0 : c == 0 ? red : c == 1 ? green : blue;
        value += weight * sample_value(first + c);
    }
    imageStore(image, ivec3(x, 0), vec4(value));
}
