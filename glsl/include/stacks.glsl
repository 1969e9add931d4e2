// The texels of blur stacks: a float; or packed, a coefficient of I1 and one of I2 in 16 bits each. CPU reference:
// src/engine/stages/stack.rs.
//
// The 16 bits are the square root of the coefficient in fixed point, with its sign, so that steps grow with the
// brightness as photon noise does. White, the unit of packed coefficients, is the largest intensity of both
// photographs.

layout(constant_id = 6) const bool PACKED = false;

// The largest magnitude of a packed coefficient, in whites, and the steps of its root from zero to there.
const float FIXED_MOST = 3.0;
const float FIXED_STEPS = 32767.0;

// Photographs that are darker are black: white must have a reciprocal.
const float LEAST_WHITE = 1e-30;

// The square of a step, in whites.
const float SQUARED_STEP = FIXED_MOST / (FIXED_STEPS * FIXED_STEPS);

// The coefficient of I1 (image 1) or I2 in a packed texel, in squares of a step.
float in_squares(uint texel, int image) {
    float root = float(bitfieldExtract(int(texel), image == 1 ? 0 : 16, 16));
    return root * abs(root);
}

// The same in whites.
float unpacked(uint texel, int image) {
    return SQUARED_STEP * in_squares(texel, image);
}

// The texel of two coefficients in whites, of I1 and of I2.
uint packed_texel(float first, float second) {
    vec2 both = vec2(first, second);
    return packSnorm2x16(sign(both) * sqrt(1.0 / FIXED_MOST * abs(both)));
}
