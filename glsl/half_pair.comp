#version 460
// Compares two frames of a sweep where the first is the sharper: the linear system for du, and the sums of their
// registration. CPU reference: src/engine/stages/half_pair.rs.

#extension GL_KHR_shader_subgroup_arithmetic : require

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;

#include "stack.glsl"
#include "accumulate.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray focus;
layout(binding = 1, r32ui) uniform readonly uimage2DArray stacks;         // of the sharper frame
layout(binding = 2, r32f) uniform readonly image2DArray aligned;        // all frames
layout(binding = 3, r32f) uniform image2DArray system;                  // D, b, q; or D, b and two of noise
layout(binding = 4, std430) writeonly buffer Partials { float partials[]; };
layout(binding = 5, std430) readonly buffer Tiles { uint tiles[]; };
layout(binding = 6, std430) readonly buffer Hidden { uint hidden[]; };  // bits, per pixel and frame: where it does not count
layout(push_constant) uniform Constants {
    int width, height;
    int nodes;
    uint other;                      // layer of the other frame
    int row;                         // first row of partial sums
    int listed;                      // first entry of the list of tiles
    uint own;                        // layer of the sharper frame
    uint words;                      // of bits per pixel; 0 if all pixels of all frames count
    float own_setting, other_setting;
    float rate;                      // c, px² of the level
    float grain;                     // f, px²
    float eta;
    float limit;                     // of V, px²
    float far;                       // pixels where the sharper frame is blurred by more are left out, px²
    float length;                    // L, the length that places are divided by, pixels
    float centre[2];
    float shown[4];                  // left, top, right and bottom of the area that both frames show, pixels
    float baseline[2];               // parallax of the other frame minus that of the sharper one, pixels per setting
    float per_u;                     // 0; or for sums of a step of parallax, u times this is the displacement by its unknown
};

#include "tiles.glsl"

layout(constant_id = 3) const bool STAYS = false;   // T and c are held: no sums; for q two estimates of D by noise

const int ROWS = 8;                  // lines per invocation
const float FILTERED = 4.0;          // pixels along the border that low pass and high pass reach

bool is_hidden(ivec2 x, uint frame) {
    return (hidden[(x.y * width + x.x) * words + frame / 32u] >> frame % 32u & 1u) != 0u;
}

float unit_of_coefficients() { return 1.0; }
float coefficient(int image, ivec3 place) { return uintBitsToFloat(imageLoad(stacks, place).r); }

// D, b and q of a pixel. Adds to the sums.
vec4 pixel(ivec2 x, inout Sums sums) {
    float u = imageLoad(focus, ivec3(x, 0)).r;
    vec2 away = vec2(own_setting, other_setting) - u;
    float v = rate * (away.y * away.y - away.x * away.x), before = rate * away.x * away.x;
    float reach = 3.0 * sqrt(max(v, 0.0)) + FILTERED;
    vec4 inside = vec4(vec2(x) - vec2(shown[0], shown[1]), vec2(shown[2], shown[3]) - vec2(x));
    if (!(v > 0.0 && v < limit && before <= far) || any(lessThan(inside, vec4(reach)))) return vec4(0.0);
    if (words > 0u && (is_hidden(x, own) || is_hidden(x, other))) return vec4(0.0);
    ivec2 size = ivec2(width, height);
    ivec3 columns = beside(x.x, size.x), lines = beside(x.y, size.y);
    Blurred blurred = ANY_KERNEL ? stack_at(1, nodes, size, v, x, vec2(0.0)) : stack_on(1, nodes, v, columns, lines, vec2(0.0));
    float n = 1.0 + grain / (grain + v), slope = -grain / ((grain + v) * (grain + v)), root = inversesqrt(n);
    float left = blurred.value - imageLoad(aligned, ivec3(x, other)).r, s = root * left;
    float by_v = root * (blurred.slope - 0.5 * left * slope / n);
    vec2 j = -root * blurred.gradient, moves = vec2(baseline[0], baseline[1]);
    float v_by_u = -2.0 * rate * (other_setting - own_setting), by_u = v_by_u * by_v + dot(moves, j), by_rate = by_v * v;
    float share = 1.0 / (1.0 + 4.0 * max(before - limit, 0.0) / limit), w = share * inversesqrt(s * s + eta * eta);
    float y = (float(x.y) - centre[1]) / length;
    if (per_u != 0.0) {
        float d = per_u * u;
        vec3 n = d * product(w, j);
        add_pixel(sums, n, d * w * s * j, 0.0, y, 0.0);
        sums.roughness += d * n.xy;
        sums.spread += d * n.z;
        return vec4(0.0);
    }
    if (STAYS) {
        sums.valid += share;
        float of_noise = 0.5 * grain / (n * (grain + v) * (grain + v)) * (v_by_u * v_by_u / (grain + v) + dot(moves, moves));
        float variance = s * s * (1.0 + 0.5 * log(1.0 + s * s / (eta * eta)));
        return w * vec4(by_u * by_u, -by_u * s, of_noise, of_noise * variance);
    }
    add_pixel(sums, product(w, j), w * s * j, w * s * s, y, share);
    sums.roughness += w * by_rate * vec2(by_rate, s);
    return w * by_u * vec4(by_u, -s, by_rate, 0.0);
}

void main() {
    Sums sums = no_sums();
    uvec2 tile = tile_at(listed);
    ivec2 x = ivec2(1, ROWS) * invocation(tile, gl_WorkGroupSize.xy);
    for (int n = 0; n < ROWS; n++, x.y++) {
        if (x.x >= width || x.y >= height) break;
        vec4 contribution = pixel(x, sums);
        if (contribution == vec4(0.0)) continue;
        for (int layer = 0; layer < (STAYS ? 4 : 3); layer++) {
            imageStore(system, ivec3(x, layer), vec4(imageLoad(system, ivec3(x, layer)).r + contribution[layer]));
        }
    }
    float sum = workgroup_sum(sums, (float(x.x) - centre[0]) / length);
    uint n = gl_LocalInvocationIndex;
    uint columns = (width + gl_WorkGroupSize.x - 1) / gl_WorkGroupSize.x;
    if (n < SUMS) partials[(row + tile.y * columns + tile.x) * SUMS + n] = sum;
}
