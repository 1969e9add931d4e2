// The coefficients of both blur stacks. The includer declares `stacks`, and `second_stack`, the first layer of I2 if it
// is not packed. They are in units of UNIT, which splines multiply by.

float coefficient(int image, ivec3 place) {
    if (PACKED) return in_steps(imageLoad(stacks, place).r, image);
    return uintBitsToFloat(imageLoad(stacks, place + ivec3(0, 0, image == 1 ? 0 : second_stack)).r);
}

// Those of I1 and of I2.
vec2 coefficients(ivec3 place) {
    if (!PACKED) return vec2(coefficient(1, place), coefficient(2, place));
    uint texel = imageLoad(stacks, place).r;
    return vec2(in_steps(texel, 1), in_steps(texel, 2));
}
