#version 460
// The means of the smoothed blur-matched pair at samples: of every `every`-th pixel along x and y, weighed by a window.
// CPU reference: src/engine/stages/pair_samples.rs.

#extension GL_EXT_control_flow_attributes : require

const int VECTORS = 1024;            // of four filters: the 16 KiB that each device allows a uniform buffer

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray pair;
layout(binding = 1, std140) uniform Filters { vec4 filters[VECTORS]; };
layout(binding = 2, std430) writeonly buffer Samples { float samples[]; };   // by layers of the pair, row by row
layout(push_constant) uniform Constants {
    int width, height;               // of the pair
    int every;                       // pixels from sample to sample
    int offset;                      // of the window among the vectors of filters
    int radius;
};

// The most filters of the window along an axis.
const int TAPS = 19;

// A place beyond the border, mirrored.
int inside(int place, int length) {
    int period = max(2 * (length - 1), 1);
    place = abs(place) % period;
    return min(place, period - place);
}

void main() {
    ivec2 sample_at = ivec2(gl_GlobalInvocationID.xy), count = (ivec2(width, height) + every - 1) / every;
    if (any(greaterThanEqual(sample_at, count))) return;
    int plane = int(gl_GlobalInvocationID.z);
    ivec2 first = every * sample_at - radius;
    int columns[TAPS];
    [[unroll]] for (int n = 0; n < TAPS; n++) columns[n] = inside(first.x + n, width);
    float sum = 0.0;
    for (int m = 0; m <= 2 * radius; m++) {
        int y = inside(first.y + m, height);
        float row = 0.0;
        // Weights beyond the window are zero.
        [[unroll]] for (int n = 0; n < TAPS; n++)
            row += filters[offset + n / 4][n % 4] * imageLoad(pair, ivec3(columns[n], y, plane)).r;
        sum += filters[offset + m / 4][m % 4] * row;
    }
    samples[(plane * count.y + sample_at.y) * count.x + sample_at.x] = sum;
}
