// The texels of blur stacks: a float; or packed, a coefficient of I1 and one of I2 in 16-bit fixed point. CPU reference:
// src/engine/stages/stack.rs.

layout(constant_id = 6) const bool PACKED = false;

// The largest magnitude of a packed coefficient, and the steps from zero to there.
const float FIXED_MOST = 3.0;
const float FIXED_STEPS = 32767.0;

// What a coefficient of 1 stands for, once it is a float.
const float UNIT = PACKED ? FIXED_MOST / FIXED_STEPS : 1.0;

// The coefficient of I1 (image 1) or I2 in a packed texel, in steps.
float in_steps(uint texel, int image) {
    return float(bitfieldExtract(int(texel), image == 1 ? 0 : 16, 16));
}

// The same as a number.
float unpacked(uint texel, int image) {
    return FIXED_MOST / FIXED_STEPS * in_steps(texel, image);
}

// The texel of two coefficients, of I1 and of I2.
uint packed_texel(float first, float second) {
    return packSnorm2x16(1.0 / FIXED_MOST * vec2(first, second));
}
