#version 460
// Samples as the sensor gave them to one channel in [0, 1]. Twin: src/stages/ingest.rs.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Samples { uint samples[]; };
layout(binding = 1, r32f) uniform writeonly image2DArray image;
layout(push_constant) uniform Constants {
    uint width, height, channels, bytes, decode;
    float red, green, blue;
};

float sample_value(uint i) {
    uint word = samples[i * bytes / 4];
    uint shift = 8 * (i * bytes % 4);
    float value = bytes == 1 ? float(word >> shift & 0xffu) / 255.0
                : bytes == 2 ? float(word >> shift & 0xffffu) / 65535.0
                : uintBitsToFloat(word);
    if (decode == 0) return value;
    return value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4);
}

void main() {
    uvec2 x = gl_GlobalInvocationID.xy;
    if (x.x >= width || x.y >= height) return;
    uint first = (x.y * width + x.x) * channels;
    float value = channels == 1 ? sample_value(first)
                                : red * sample_value(first) + green * sample_value(first + 1) + blue * sample_value(first + 2);
    imageStore(image, ivec3(x, 0), vec4(value));
}
