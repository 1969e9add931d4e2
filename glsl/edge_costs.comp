#version 460
// The costs of displaced outlines: how well two layers, the front one in focus at its own V and hiding part of the
// other, explain both photographs around a depth edge. A workgroup for each cell with an edge. CPU reference:
// src/engine/stages/edge_costs.rs.

// A row of invocations per order: with the near side in front, and with the far side. An invocation has one place along
// the normal, and all lines as the components of a vector.
const int ROWS = 2, ROW = 64;
layout(local_size_x = ROW, local_size_y = ROWS, local_size_x_id = 0, local_size_y_id = 1) in;
// Two frames of a sweep, on one frame's pixels; costs are added to those of others.
layout(constant_id = 2) const bool SWEEP = false;

#include "state.glsl"

layout(binding = 0, r32f) uniform readonly image2DArray image1;
layout(binding = 1, r32f) uniform readonly image2DArray image2;
layout(binding = 2, r32f) uniform readonly image2DArray relative_blur;   // u in a sweep
// Of a sweep costs are read that an earlier dispatch wrote; of each cell its share.
layout(binding = 3, r32f) uniform coherent image2DArray results;
layout(binding = 4, std430) readonly buffer StateBuffer { State state; };
layout(binding = 5, std430) readonly buffer Arguments { uint arguments[]; };
layout(binding = 6, std430) readonly buffer Listed { uint listed[]; };
layout(push_constant) uniform Constants {
    int width, height;
    float centre[2];
    float factor;                    // pixels of the full-size image per pixel of this level
    // Of a sweep: c, px² by squared settings; of the frames, that with the larger setting first: settings and layers.
    float rate, settings[2];
    int layers[2];
    uint argument_place;
};

#include "edge.glsl"
#include "edge_list.glsl"

// The photographs are sampled along the normal, to HALF px on either side of where V is halfway, on LINES lines a pixel
// apart, and on REACH more on either side of them, for blur across the normal.
const int HALF = 24, ALONG = 2 * HALF + 1, LINES = 4, REACH = 10;
// Costs are summed over this distance from where V is halfway, px.
const int WINDOW = 14;
// The least deviation of a residual: an intensity, and a share of the contrast.
const float LEAST = 0.005, CONTRAST = 0.1;
// The price of texture that neither photograph shows undisturbed, as a share of its variance.
const float HIDDEN = 0.3;
// The layer behind is not restored from less than this share of the light.
const float DIM = 0.12;

// Kernels are Gaussians of at least this variance, px², and end at EXTENT σ. Of a side: of its own V, of both sides',
// of its own and the texture's, of the texture's, of local means, and of the rim of what is in focus.
const float LEAST_VARIANCE = 0.08, EXTENT = 2.6;
const int OWN = 0, BOTH = 1, OWN_TEXTURE = 2, TEXTURE = 3, MEAN = 4, RIM = 5, KERNELS = 6;
const float MEAN_VARIANCE = 4.0, TEXTURE_VARIANCE = 6.25, RIM_VARIANCE = 0.36;

// How much a pair of frames says, by how far its frames are out of focus on either side of the edge: σ² of a Gaussian,
// px² of blur, and how far they may be.
const float FOCUSED = 1.0, FAR = 4.0;
// The largest |V| of a side, px²: the blur that the samples have room for.
const float LARGEST = 16.0;
// By row: the kernels of the side that is in front in its order, and where they end.
shared float kernels[ROWS][KERNELS][REACH + 1];
shared int reach[ROWS][KERNELS];
// The photograph in which the side is the sharper, after blur across the normal by each kernel but the last.
shared vec4 blurred[ROWS][RIM][ALONG];
// The restored layer behind times its weights, under the kernel OWN of the back and under TEXTURE; the weights.
shared vec4 layer[ROWS][ALONG], layer_coarse[ROWS][ALONG];
shared float weights[ROWS][ALONG];
shared vec4 totals[ROWS][ROW];

int row() { return int(gl_LocalInvocationID.y); }
int place_in_row() { return int(gl_LocalInvocationID.x); }

// The sum over a row.
vec4 row_total(vec4 value) {
    barrier();
    totals[row()][place_in_row()] = value;
    for (int half_row = ROW / 2; half_row > 0; half_row /= 2) {
        barrier();
        if (place_in_row() < half_row) totals[row()][place_in_row()] += totals[row()][place_in_row() + half_row];
    }
    barrier();
    return totals[row()][0];
}

float at(int image, ivec2 x) {
    x = clamp(x, ivec2(0), ivec2(width, height) - 1);
    if (SWEEP) return image == 0 ? imageLoad(image1, ivec3(x, layers[0])).r : imageLoad(image2, ivec3(x, layers[1])).r;
    return image == 0 ? imageLoad(image1, ivec3(x, 0)).r : imageLoad(image2, ivec3(x, 0)).r;
}

vec2 image_centre() { return vec2(centre[0], centre[1]); }

// The factor on I2 around an edge, where the shading hardly changes.
float gain_at(vec2 x) {
    if (SWEEP) return 1.0;
    Registration r = state.registration;
    vec2 in_image2 = x + displacement_at(r, x, factor, image_centre());
    return r.gain * shading_at(state.applied_shading, (in_image2 - image_centre()) / image_centre());
}

// I1, or I2 on I1's pixels with I1's brightness, by the gain around the edge. v is V of the side.
float photograph_at(int image, float gain, vec2 x, float v) {
    vec2 last = vec2(width, height) - 1.0;
    x = clamp(x, vec2(0.0), last);
    if (image == 1 && !SWEEP) {
        vec2 d = displacement_of(state.registration, state.parallax, x, v, factor, image_centre());
        x = clamp(x + d, vec2(0.0), last);
    }
    ivec2 i = ivec2(floor(x));
    vec2 f = x - vec2(i);
    float value = mix(mix(at(image, i), at(image, i + ivec2(1, 0)), f.x),
                      mix(at(image, i + ivec2(0, 1)), at(image, i + ivec2(1)), f.x), f.y);
    return image == 0 || SWEEP ? value : gain * value + state.registration.offset;
}

// V of the side on which a sample is.
float side_of(Edge edge, int k) { return k < HALF ? edge.far : edge.near; }

// The place of a sample.
vec2 place_on(Edge edge, float line, int k) {
    return edge.place + float(k - HALF) * edge.normal
        + (line - 0.5 * float(LINES - 1)) * vec2(-edge.normal.y, edge.normal.x);
}

vec4 photograph_on_lines(int image, float gain, Edge edge, int k) {
    vec4 values;
    float v = side_of(edge, k);
    for (int line = 0; line < LINES; line++) values[line] = photograph_at(image, gain, place_on(edge, float(line), k), v);
    return values;
}

// V between two frames of a sweep where u is in focus.
float relative_blur_of(float u) {
    return SWEEP ? rate * (settings[0] - settings[1]) * (2.0 * u - settings[0] - settings[1]) : u;
}

float relative_blur_at(vec2 x) {
    ivec2 i = ivec2(floor(x)), last = ivec2(width, height) - 1;
    vec2 f = x - vec2(i);
    ivec2 low = clamp(i, ivec2(0), last), high = clamp(i + 1, ivec2(0), last);
    vec2 above = vec2(imageLoad(relative_blur, ivec3(low, 0)).r, imageLoad(relative_blur, ivec3(high.x, low.y, 0)).r);
    vec2 below = vec2(imageLoad(relative_blur, ivec3(low.x, high.y, 0)).r, imageLoad(relative_blur, ivec3(high, 0)).r);
    vec2 both = mix(above, below, f.y);
    return relative_blur_of(mix(both.x, both.y, f.x));
}

// The share of a pair of frames in the costs of a cell: 0 if it has none.
float share_of(Edge edge) {
    if (!SWEEP) return 1.0;
    float v_near = relative_blur_of(edge.near), v_far = relative_blur_of(edge.far);
    float near = edge.near - settings[0], far = edge.far - settings[1], blur = rate * (near * near + far * far);
    bool fits = v_near > 0.0 && v_far < 0.0 && max(v_near, -v_far) <= LARGEST && blur <= FAR;
    return fits ? exp(-blur / (2.0 * FOCUSED)) : 0.0;
}

void set_kernel(int n, float variance) {
    variance = max(variance, LEAST_VARIANCE);
    int last = min(int(ceil(EXTENT * sqrt(variance))), REACH);
    float sum = -1.0;
    for (int i = 0; i <= REACH; i++) {
        float weight = i > last ? 0.0 : exp(-float(i * i) / (2.0 * variance));
        kernels[row()][n][i] = weight;
        sum += 2.0 * weight;
    }
    for (int i = 0; i <= REACH; i++) kernels[row()][n][i] /= sum;
    reach[row()][n] = last;
}

vec4 cost(vec4 residual, vec4 variance, float least) {
    return log(1.0 + residual * residual / variance) + 0.5 * log(variance / least);
}

// The blur across the normal, of the photograph in which the row's side is the sharper. Weights are computed: software
// devices read shared memory one invocation after the other.
void blur_across(int image, float gain, Edge edge, float variances[KERNELS]) {
    int k = place_in_row(), widest = 0;
    vec4 sums[RIM] = vec4[](vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    float rates[RIM], lasts[RIM];
    for (int n = 0; n < RIM; n++) {
        rates[n] = 0.5 / max(variances[n], LEAST_VARIANCE);
        lasts[n] = float(reach[row()][n]);
        widest = max(widest, reach[row()][n]);
    }
    for (int i = -widest; i < LINES + widest; i++) {
        float value = photograph_at(image, gain, place_on(edge, float(i), k), side_of(edge, k));
        vec4 away = abs(vec4(0.0, 1.0, 2.0, 3.0) - float(i)), square = away * away;
        for (int n = 0; n < RIM; n++) {
            sums[n] += exp(-rates[n] * square) * vec4(lessThanEqual(away, vec4(lasts[n]))) * value;
        }
    }
    for (int n = 0; n < RIM; n++) blurred[row()][n][k] = kernels[row()][n][0] * sums[n];
}

// The mean of a blurred photograph over samples from `first` to `last`, by a kernel of this row; over all where none of
// them is in reach. In the reversed order samples are counted from the other end.
vec4 mean_between(int kernel, int of_row, int k, int first, int last) {
    bool reversed = row() == 1;
    vec4 sum = vec4(0.0);
    float weight = 0.0;
    int most = reach[row()][kernel], low = max(-most, first - k), high = min(most, last - k);
    if (low > high) {
        low = max(-most, -k);
        high = min(most, ALONG - 1 - k);
    }
    for (int i = low; i <= high; i++) {
        int q = k + i;
        sum += kernels[row()][kernel][abs(i)] * blurred[of_row][kernel][reversed ? ALONG - 1 - q : q];
        weight += kernels[row()][kernel][abs(i)];
    }
    return sum / weight;
}

// The mean square of a difference over samples from `first` to `last` from the middle, as a share of the sum over a
// row.
float squared_if(vec4 difference, int from_middle, int first, int last) {
    return from_middle >= first && from_middle <= last ? dot(difference, difference) / float(LINES * (last - first + 1)) : 0.0;
}

// Variance of the texture: in front; outside it in the same photograph; behind, where the front's blur does not reach.
vec3 texture_variances(bool opposite, vec4 in_sharper, vec4 in_other) {
    int own = row(), back_row = row() ^ 1, k = place_in_row();
    vec4 squares = vec4(0.0), back_sharp = opposite ? in_other : in_sharper;
    if (k < ALONG) {
        squares.x = squared_if(in_sharper - mean_between(MEAN, own, k, HALF + 2, ALONG - 1), k - HALF, 4, 16);
        squares.y = squared_if(in_sharper - mean_between(MEAN, own, k, 0, HALF + 1), k - HALF, -14, 0);
        squares.z = squared_if(back_sharp - mean_between(TEXTURE, back_row, k, 0, HALF - 2), k - HALF, -16, -4);
    }
    return row_total(squares).xyz;
}

// The costs of all displacements in the row's order: a share per invocation. `opposite`: the back is the sharper in the
// other photograph.
void share_of_costs(bool opposite, vec4 in_sharper, vec4 in_other, vec3 texture_variance, float average, float least,
                    out float shares[DISPLACEMENTS]) {
    bool reversed = row() == 1, is_sample = place_in_row() < ALONG;
    int own = row(), back_row = row() ^ 1, k = min(place_in_row(), ALONG - 1), seen = reversed ? ALONG - 1 - k : k;
    // Sums over what is inside the outline and outside it. They lose or gain a sample as it moves on by a pixel.
    int outline = HALF - BACKWARD;
    float covered = 0.0, inner_weight = 0.0, outer_weight = 0.0;
    vec4 light = vec4(0.0), hidden = vec4(0.0), hidden_coarse = vec4(0.0), inner = vec4(0.0), outer = vec4(0.0);
    vec4 back = blurred[back_row][OWN][seen], back_coarse = blurred[back_row][TEXTURE][seen];
    for (int i = max(-reach[own][OWN], outline - k); i <= reach[own][OWN]; i++) {
        int q = min(k + i, ALONG - 1);
        q = reversed ? ALONG - 1 - q : q;
        float weight = kernels[own][OWN][abs(i)];
        covered += weight;
        light += weight * blurred[own][OWN][q];
        hidden += weight * blurred[own][BOTH][q];
        hidden_coarse += weight * blurred[own][OWN_TEXTURE][q];
    }
    int most = reach[own][MEAN];
    for (int i = max(-most, -k); i <= min(most, ALONG - 1 - k); i++) {
        int q = reversed ? ALONG - 1 - k - i : k + i;
        float weight = kernels[own][MEAN][abs(i)];
        vec4 value = weight * blurred[own][MEAN][q];
        bool is_inner = k + i >= outline;
        inner += is_inner ? value : vec4(0.0);
        inner_weight += is_inner ? weight : 0.0;
        outer += is_inner ? vec4(0.0) : value;
        outer_weight += is_inner ? 0.0 : weight;
    }
    bool counts = abs(k - HALF) <= WINDOW && is_sample;
    for (int n = 0; n < DISPLACEMENTS; n++, outline++) {
        float passing = 1.0 - covered;
        barrier();
        if (is_sample) {
            // The back in the other photograph, without the front's light; or in the same one, outside.
            float share = max(passing, DIM), weight = opposite ? (passing < DIM ? 0.0 : passing * passing) : float(k < outline);
            vec4 fine = opposite ? clamp((back - hidden) / share, -0.3, 1.3) : back;
            vec4 coarse = opposite ? clamp((back_coarse - hidden_coarse) / share, -0.3, 1.3) : back_coarse;
            layer[own][k] = weight * fine;
            layer_coarse[own][k] = weight * coarse;
            weights[own][k] = weight;
        }
        barrier();
        shares[n] = 0.0;
        if (counts) {
            vec4 behind = vec4(0.0), behind_coarse = vec4(0.0);
            float known = 0.0, known_coarse = 0.0, rim = 0.0;
            for (int i = -reach[back_row][OWN]; i <= reach[back_row][OWN]; i++) {
                float weight = kernels[back_row][OWN][abs(i)];
                behind += weight * layer[own][k + i];
                known += weight * weights[own][k + i];
            }
            for (int i = -reach[own][TEXTURE]; i <= reach[own][TEXTURE]; i++) {
                float weight = kernels[own][TEXTURE][abs(i)];
                behind_coarse += weight * layer_coarse[own][k + i];
                known_coarse += weight * weights[own][k + i];
            }
            for (int i = max(-reach[own][RIM], outline - k); i <= reach[own][RIM]; i++) rim += kernels[own][RIM][abs(i)];
            behind_coarse = known_coarse > 1e-3 ? behind_coarse / known_coarse : vec4(average);
            behind = known > 1e-3 ? behind / known : behind_coarse;
            float unknown = clamp(1.0 - known, 0.0, 1.0), gap = HIDDEN * unknown * unknown * texture_variance.z;
            vec4 near_mean = inner_weight > 1e-3 ? inner / inner_weight : vec4(average);
            vec4 far_mean = outer_weight > 1e-3 ? outer / outer_weight : vec4(average);
            // The other photograph: the front's light and what passes of the back's.
            vec4 predicted = light + passing * (opposite ? behind_coarse : behind);
            float variance = passing * passing * (opposite ? texture_variance.z : gap);
            vec4 costs = cost(predicted - in_other, vec4(least + variance), least);
            // The sharper photograph: inside like its neighbours inside, outside like the back.
            bool is_inside = k >= outline;
            predicted = is_inside ? near_mean : opposite ? mix(behind, near_mean, rim) : far_mean;
            variance = opposite ? rim * rim * texture_variance.x + (1.0 - rim) * (1.0 - rim) * gap : texture_variance.y;
            costs += cost(predicted - in_sharper, vec4(least + (is_inside ? texture_variance.x : variance)), least);
            shares[n] = dot(costs, vec4(1.0));
        }
        // The sample at the outline leaves the inside.
        int away = abs(outline - k), q = reversed ? ALONG - 1 - outline : outline;
        float weight = away > REACH ? 0.0 : kernels[own][OWN][min(away, REACH)];
        covered -= weight;
        light -= weight * blurred[own][OWN][q];
        hidden -= weight * blurred[own][BOTH][q];
        hidden_coarse -= weight * blurred[own][OWN_TEXTURE][q];
        weight = away > REACH ? 0.0 : kernels[own][MEAN][min(away, REACH)];
        vec4 value = weight * blurred[own][MEAN][q];
        inner -= value;
        inner_weight -= weight;
        outer += value;
        outer_weight += weight;
    }
}

// The cost of V as it is in the row's order, a share per invocation: S takes the place of the two layers, and texture
// costs the same as there. The front ends where V is halfway. S is that of a Gaussian, as in the costs of outlines: the
// solve's is less, since it knows the kernel better. Across the normal the blur is that of the side's V.
float cost_before(Edge edge, bool opposite, vec4 in_sharper, vec4 in_other, vec3 texture_variance, float least) {
    bool reversed = row() == 1;
    int own = row(), back_row = row() ^ 1, k = min(place_in_row(), ALONG - 1), seen = reversed ? ALONG - 1 - k : k;
    if (abs(k - HALF) > WINDOW || place_in_row() >= ALONG) return 0.0;
    vec4 front = in_sharper - mean_between(MEAN, own, k, HALF, ALONG - 1);
    vec4 back = opposite ? in_other - mean_between(TEXTURE, back_row, k, 0, HALF - 1)
                         : in_sharper - mean_between(MEAN, own, k, 0, HALF - 1);
    float back_variance = opposite ? texture_variance.z : texture_variance.y;
    vec4 total = vec4(0.0);
    for (int line = 0; line < LINES; line++) {
        // Samples of the reversed order keep their lines, on which they are counted from the other end.
        float v = relative_blur_at(place_on(edge, float(line), seen));
        bool is_front = v > 0.5 * (edge.near + edge.far) != reversed;
        // S by the photograph that is the sharper at this V.
        bool by_front = opposite ? v > 0.0 == (reversed ? edge.far : edge.near) > 0.0 : is_front;
        int side = by_front ? own : back_row;
        float variance = max(abs(v), LEAST_VARIANCE), predicted = 0.0, sum = 0.0;
        int last = min(int(ceil(EXTENT * sqrt(variance))), REACH);
        for (int i = -last; i <= last; i++) {
            float weight = exp(-float(i * i) / (2.0 * variance));
            predicted += weight * blurred[side][OWN][seen + i][line];
            sum += weight;
        }
        float residual = predicted / sum - (by_front || !opposite ? in_other : in_sharper)[line];
        float deviation = (is_front ? front : back)[line];
        total[line] = log(1.0 + residual * residual / least)
            + cost(vec4(deviation), vec4(least + (is_front ? texture_variance.x : back_variance)), least).x;
    }
    return dot(total, vec4(1.0));
}

void main() {
    ivec2 cell = listed_cell();
    if (cell.x < 0) return;
    Edge edge = edge_of(cell);
    float share = share_of(edge);
    if (share == 0.0) return;
    edge.near = relative_blur_of(edge.near);
    edge.far = relative_blur_of(edge.far);
    bool reversed = row() == 1;
    int k = min(place_in_row(), ALONG - 1);
    float gain = gain_at(edge.place);
    float own = abs(reversed ? edge.far : edge.near), other = abs(reversed ? edge.near : edge.far);
    int sharper = (reversed ? edge.far : edge.near) > 0.0 ? 0 : 1;
    bool opposite = (edge.near > 0.0) != (edge.far > 0.0);
    float variances[KERNELS] = float[](own, own + other, own + TEXTURE_VARIANCE, TEXTURE_VARIANCE, MEAN_VARIANCE,
                                       RIM_VARIANCE);
    if (place_in_row() < KERNELS) set_kernel(place_in_row(), variances[place_in_row()]);
    barrier();
    if (place_in_row() < ALONG) blur_across(sharper, gain, edge, variances);
    // Average and variance of the photograph in which the near side is the sharper.
    vec4 of_near = photograph_on_lines(edge.near > 0.0 ? 0 : 1, gain, edge, k);
    if (place_in_row() >= ALONG) of_near = vec4(0.0);
    vec4 moments = row_total(vec4(dot(of_near, vec4(1.0)), dot(of_near, of_near), 0.0, 0.0)) / float(LINES * ALONG);
    float least = LEAST * LEAST + CONTRAST * CONTRAST * max(moments.y - moments.x * moments.x, 0.0);
    int seen = reversed ? ALONG - 1 - k : k;
    vec4 in_sharper = photograph_on_lines(sharper, gain, edge, seen);
    vec4 in_other = photograph_on_lines(1 - sharper, gain, edge, seen);
    float shares[DISPLACEMENTS];
    vec3 textures = texture_variances(opposite, in_sharper, in_other);
    share_of_costs(opposite, in_sharper, in_other, textures, moments.x, least, shares);
    float before = cost_before(edge, opposite, in_sharper, in_other, textures, least);
    for (int m = 0; m < DISPLACEMENTS + 1; m += 4) {
        vec4 some;
        for (int i = 0; i < 4; i++) some[i] = m + i < DISPLACEMENTS ? shares[min(m + i, DISPLACEMENTS - 1)] : before;
        some = row_total(some);
        if (place_in_row() < 4) {
            int target = reversed ? REVERSED_COSTS : COSTS, number = m + place_in_row();
            float sum = some[place_in_row()];
            if (SWEEP) sum = number_of(cell, target, number) + share * sum;
            imageStore(results, place_of(cell, target, number), vec4(sum));
        }
    }
    if (!reversed && place_in_row() == 0) {
        imageStore(results, place_of(cell, EDGES, TOTAL), vec4(number_of(cell, EDGES, TOTAL) + share));
    }
}
