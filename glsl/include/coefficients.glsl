// The coefficients of both blur stacks. The includer declares `stacks`, the state, and `second_stack`, the first layer
// of I2 if it is not packed.

float unit_of_coefficients() { return PACKED ? SQUARED_STEP * uintBitsToFloat(state.white) : 1.0; }

float coefficient(int image, ivec3 place) {
    if (PACKED) return in_squares(imageLoad(stacks, place).r, image);
    return uintBitsToFloat(imageLoad(stacks, place + ivec3(0, 0, image == 1 ? 0 : second_stack)).r);
}

// Those of I1 and of I2.
vec2 coefficients(ivec3 place) {
    if (!PACKED) return vec2(coefficient(1, place), coefficient(2, place));
    uint texel = imageLoad(stacks, place).r;
    return vec2(in_squares(texel, 1), in_squares(texel, 2));
}
