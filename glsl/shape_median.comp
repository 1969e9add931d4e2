#version 460
// The kernel's shape as the weighted median of its estimates in windows. One workgroup. CPU reference:
// src/engine/stages/shape_median.rs.

#include "state.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) buffer StateBuffer { State state; };
layout(push_constant) uniform Constants {
    int windows;
};

const int MOST_WINDOWS = 256;
const float LEAST_WINDOWS = 8.0, LEAST_SHAPE = 0.1, MOST_SHAPE = 4.0;
const float UNBIASED = 0.75;
shared vec2 estimates[MOST_WINDOWS];     // shape, weight
shared float quartiles[3];

void main() {
    int first = int(gl_LocalInvocationIndex), step = int(gl_WorkGroupSize.x * gl_WorkGroupSize.y);
    for (int n = first; n < windows; n += step) estimates[n] = vec2(partials[2 * n], partials[2 * n + 1]);
    barrier();
    float sum = 0.0, squares = 0.0;
    for (int n = 0; n < windows; n++) {
        sum += estimates[n].y;
        squares += estimates[n].y * estimates[n].y;
    }
    for (int n = first; n < windows; n += step) {
        float below = 0.0;
        for (int m = 0; m < windows; m++) {
            if (estimates[m].x < estimates[n].x || estimates[m].x == estimates[n].x && m < n) below += estimates[m].y;
        }
        for (int k = 0; k < 3; k++) {
            float target = 0.25 * float(k + 1) * sum;
            if (below < target && target <= below + estimates[n].y) quartiles[k] = estimates[n].x;
        }
    }
    barrier();
    float independent = sum * sum / max(squares, 1e-30);
    if (first != 0 || independent < LEAST_WINDOWS) return;
    float shape = UNBIASED * (state.kernel_shape + quartiles[1]);
    // The deviation of a median is 1.25 times that of a mean; quartiles are 1.35 deviations apart.
    float deviation = UNBIASED * 1.25 / 1.35 * (quartiles[2] - quartiles[0]) / sqrt(independent);
    state.kernel_shape = shape > max(LEAST_SHAPE, 2.0 * deviation) ? min(shape, MOST_SHAPE) : 0.0;
}
