#version 460
// Chooses the unit of intensities, a power of two, by samples of both photographs. One workgroup. CPU reference:
// src/engine/stages/unit.rs.

#include "samples.glsl"
#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer First { uint first[]; };
layout(binding = 1, std430) readonly buffer Second { uint second[]; };
layout(binding = 2, std430) buffer StateBuffer { State state; };
layout(constant_id = 2) const bool SRGB = false;    // decodes the sRGB curve
layout(push_constant) uniform Constants {
    uint width, height;
    uint channels[2];                // 1 or 3, interleaved, of either photograph
    uint bytes[2];                   // 1, 2 or 4 per sample
    float weights[3];                // of red, green and blue; unused for one channel
};

// The number of pixels sampled in each photograph, and the steps between their places along x and y, as shares of the
// side in 32 bits: 1 - 1/ρ and 1 - 1/ρ² with ρ the plastic ratio (R2, a low-discrepancy sequence).
const int PLACES = 4096;
const int ALONG_X = 1052792407, ALONG_Y = 1847521882;
// The least unit is one over this power of two; and the number of units.
const int DIMMEST = 20, OCTAVES = 41;
// Magnitudes that exceed a power of two by rounding count as equal to it.
const int ROUNDING = 1024;
// The share of the pixels that may exceed a unit, and one of at least 1.
const float BRIGHTER = 0.001, BEYOND_WHITE = 0.1;

bool is_second;

uint sample_word(uint n) {
    return is_second ? second[n] : first[n];
}

// The octave of a magnitude: the least power of two that it does not exceed, over the least unit.
int octave(float magnitude) {
    int bits = max(floatBitsToInt(magnitude) - ROUNDING, 0);
    return clamp((bits >> 23) - 126 + DIMMEST, 0, OCTAVES - 1);
}

// A place of 32 bits on a side of the frame.
uint scaled(int place, uint side) {
    uint high, low;
    umulExtended(uint(place), side, high, low);
    return high;
}

shared uint counts[OCTAVES];

void main() {
    int own = int(gl_LocalInvocationIndex), all = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int n = own; n < OCTAVES; n += all) counts[n] = 0u;
    barrier();
    for (int image = 0; image < 2; image++) {
        is_second = image == 1;
        uint count = channels[is_second ? 1 : 0], size = bytes[is_second ? 1 : 0];
        for (int n = own; n < PLACES; n += all) {
            uint pixel = scaled(n * ALONG_Y, height) * width + scaled(n * ALONG_X, width);
            float magnitude = abs(intensity(pixel, count, size, vec3(weights[0], weights[1], weights[2]), SRGB));
            atomicAdd(counts[octave(magnitude)], 1u);
        }
    }
    barrier();
    if (own != 0) return;
    uint brighter = 0u;
    int chosen = OCTAVES - 1;
    for (; chosen > 0; chosen--) {
        brighter += counts[chosen];
        if (float(brighter) > (chosen > DIMMEST ? BEYOND_WHITE : BRIGHTER) * 2.0 * float(PLACES)) break;
    }
    state.unit = intBitsToFloat(chosen - DIMMEST + 127 << 23);
    state.registration.offset *= reciprocal(state.unit);
}
