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
