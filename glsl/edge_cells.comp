#version 460
// Finds the cells at depth edges, their normals, and V of either side. CPU reference: src/engine/stages/edge_cells.rs.

#include "nan.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32f) uniform image2DArray results;            // layers: the standard deviation of V; the edges
layout(binding = 2, std430) buffer Arguments { uint arguments[]; };
layout(binding = 3, std430) writeonly buffer Listed { uint listed[]; };
layout(push_constant) uniform Constants {
    int width, height;
    uint argument_place;             // first word of the workgroups of the passes over edges
    uint pixels[2];                 // workgroups over pixels along x and y, if there is an edge
    int fused_place;                 // first word of the workgroups of edge_fuse
    uint fused[2];                  // its workgroups along x and y, if there is an edge
    int deviation_layer;             // of the standard deviation: coarser levels have one of their own
    float least_jump;                // of V, or of u in a sweep
    float half_weight;               // the deviation of V at which a pixel of a side has half the weight
    float share;                     // the least difference of the levels, as a share of the larger |V|
    float largest;                   // the largest |V| of a side: the blur that the searched profile has room for
    float widest;                    // the largest difference of the levels
    float uncertain;                 // the least deviation at the jump, as a share of it: with less it is a slope
    float shown[4];                  // left, top, right and bottom of what all photographs show, pixels
};

#include "edge.glsl"

// The least jump: as a share of the range over twice the distance, so that a slope is none; in least standard
// deviations.
const float STEEP = 0.75, CERTAIN = 5.0;
// The least difference of the levels: as a share of the least jump; in standard deviations of the difference.
const float LEVELS = 0.8, SURE = 2.5;
// The farthest pixels that a level is averaged over, and σ² of their weights by distance.
const int FARTHEST = 16;
const float WEIGHT = 64.0;
// The least V of a pixel that a level is averaged over, beyond halfway, as a share of the largest: where the side is
// narrow, the other pixels are in the slope to what is on either side of it.
const float CREST = 0.6;

float v_at(ivec2 x) {
    return imageLoad(relative_blur, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r;
}

float deviation_at(ivec2 x) {
    return imageLoad(results, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), deviation_layer)).r;
}

// V and its standard deviation between pixels.
vec2 between(vec2 x) {
    ivec2 i = ivec2(floor(x));
    vec2 f = x - vec2(i);
    vec2 above = mix(vec2(v_at(i), deviation_at(i)), vec2(v_at(i + ivec2(1, 0)), deviation_at(i + ivec2(1, 0))), f.x);
    i.y++;
    vec2 below = mix(vec2(v_at(i), deviation_at(i)), vec2(v_at(i + ivec2(1, 0)), deviation_at(i + ivec2(1, 0))), f.x);
    return mix(above, below, f.y);
}

// The means of V and of its deviation on the near (1) or far (-1) side, along the normal until V is halfway. x is 0 if
// there are less than two samples.
vec3 level(vec2 place, vec2 normal, float halfway, float side) {
    int first = side > 0.0 ? 4 : 5, end = first;
    float crest = 0.0;
    for (; end <= FARTHEST; end++) {
        vec2 sampled = between(place + side * float(end) * normal);
        float beyond = side * (sampled.x - halfway);
        // Comparisons with NaN are false: where there is no deviation, the side ends.
        if (!(beyond > 0.0 && sampled.y >= 0.0)) break;
        crest = max(crest, beyond);
    }
    if (end < first + 2) return vec3(0.0);
    vec3 sums = vec3(0.0);
    for (int k = first; k < end; k++) {
        vec2 sampled = between(place + side * float(k) * normal);
        if (side * (sampled.x - halfway) < CREST * crest) continue;
        float deviations = sampled.y / half_weight;
        sums += exp(-float(k * k) / (2.0 * WEIGHT)) / (1.0 + deviations * deviations) * vec3(1.0, sampled);
    }
    return vec3(1.0, sums.yz / sums.x);
}

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy), corner = CELL * cell;
    if (any(greaterThanEqual(cell, ivec2(width, height) / CELL))) return;
    imageStore(results, place_of(cell, EDGES, 0), vec4(0.0));
    // Ranges of V, of every other pixel.
    float high = -1e30, low = 1e30, inner_high = -1e30, inner_low = 1e30, least = 1e30;
    for (int j = -4; j < 6; j++) {
        for (int i = -4; i < 6; i++) {
            ivec2 x = corner + 2 * ivec2(i, j) + 1;
            float v = v_at(x), deviation = deviation_at(x);
            high = max(high, v);
            low = min(low, v);
            if (deviation < least) least = deviation;
            if (i >= -2 && i < 4 && j >= -2 && j < 4) {
                inner_high = max(inner_high, v);
                inner_low = min(inner_low, v);
            }
        }
    }
    float jump = inner_high - inner_low;
    if (!(jump > least_jump && jump > STEEP * (high - low) && jump > CERTAIN * least)) return;
    // The point of the cell nearest to where V is halfway.
    float halfway = 0.5 * (high + low), best = 1.5;
    vec2 place, normal = vec2(0.0);
    for (int n = 0; n < CELL * CELL; n++) {
        ivec2 x = corner + ivec2(n % CELL, n / CELL);
        vec3 above = vec3(v_at(x + ivec2(-1, -1)), v_at(x + ivec2(0, -1)), v_at(x + ivec2(1, -1)));
        vec3 here = vec3(v_at(x + ivec2(-1, 0)), v_at(x), v_at(x + ivec2(1, 0)));
        vec3 below = vec3(v_at(x + ivec2(-1, 1)), v_at(x + ivec2(0, 1)), v_at(x + ivec2(1, 1)));
        vec3 rows = above + 2.0 * here + below, weights = vec3(1.0, 2.0, 1.0);
        vec2 slope = vec2(rows.z - rows.x, dot(weights, below - above)) / 8.0;
        float steepness = length(slope);
        if (steepness < max(0.02 * (high - low), 1e-6)) continue;
        float away = (halfway - dot(weights, rows) / 16.0) / steepness;
        if (abs(away) < best) {
            best = abs(away);
            normal = slope / steepness;
            place = vec2(x) + away * normal;
        }
    }
    // Each piece of an edge belongs to one cell.
    if (normal == vec2(0.0) || ivec2(floor((place + 0.5) / float(CELL))) != cell) return;
    if (any(lessThan(place, vec2(shown[0], shown[1]))) || any(greaterThan(place, vec2(shown[2], shown[3])))) return;
    vec3 near = level(place, normal, halfway, 1.0), far = level(place, normal, halfway, -1.0);
    if (near.x == 0.0 || far.x == 0.0) return;
    float highest = max(abs(near.y), abs(far.y)), difference = near.y - far.y;
    if (!(difference > max(max(LEVELS * least_jump, share * highest), SURE * length(vec2(near.z, far.z))))) return;
    if (highest > largest || difference > widest) return;
    if (uncertain > 0.0) {
        float most = 0.0;
        for (int k = -1; k <= 1; k++) {
            float deviation = between(place + float(k) * normal).y;
            if (deviation > most) most = deviation;   // NaN is not
        }
        if (most < uncertain * difference) return;
    }
    float numbers[10] = float[](1.0, place.x, place.y, normal.x, normal.y, near.y, far.y, near.z, far.z, 0.0);
    for (int n = 0; n < 10; n++) imageStore(results, place_of(cell, EDGES, n), vec4(numbers[n]));
    uint n = atomicAdd(arguments[argument_place + COUNT_PLACE], 1);
    listed[n] = uint(cell.x) | uint(cell.y) << ROW_BIT;
    atomicMax(arguments[argument_place], min(n + 1, uint(ALONG_X)));
    atomicMax(arguments[argument_place + 1], n / uint(ALONG_X) + 1);
    // All invocations that get here write the same, in any order.
    atomicMax(arguments[argument_place + 2], 1);
    uint groups[3] = uint[](pixels[0], pixels[1], 1);
    for (int n = 0; n < 3; n++) atomicMax(arguments[argument_place + 3 + n], groups[n]);
    uint of_fuse[3] = uint[](fused[0], fused[1], 1);
    for (int n = 0; n < 3; n++) atomicMax(arguments[fused_place + n], of_fuse[n]);
}
