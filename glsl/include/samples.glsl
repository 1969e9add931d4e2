// Samples of a photograph. CPU reference: src/engine/stages/ingest.rs.

// Word n of their buffer.
uint sample_word(uint n);

// Sample i of `bytes` bytes; white of integers is 1.
float stored(uint i, uint bytes) {
    uint word = sample_word(i * bytes >> 2);
    uint shift = 8 * (i * bytes & 3);
    return bytes == 1 ? float(word >> shift & 0xffu) / 255.0
         : bytes == 2 ? float(word >> shift & 0xffffu) / 65535.0
         : uintBitsToFloat(word);
}

// The intensity of a pixel: the sum of its channels by their weights, from samples as stored, or decoded from sRGB.
float intensity(uint pixel, uint channels, uint bytes, vec3 weights, bool decodes) {
    float sum = 0.0;
    // A loop, since software devices execute both sides of a branch.
    for (uint c = 0; c < channels; c++) {
        float weight = channels == 1 ? 1.0 : weights[c], value = stored(pixel * channels + c, bytes);
        if (decodes) value = value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4);
        sum += weight * value;
    }
    return sum;
}
