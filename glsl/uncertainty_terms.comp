#version 460
// The terms of the uncertainty, on every other pixel along x and y: the curvature C of the data term, b², (∇²V)², and b
// times the sum of b around.
// CPU reference: src/engine/stages/uncertainty_terms.rs.

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray relative_blur;
layout(binding = 1, r32f) uniform readonly image2DArray normal_equations; // D, b
layout(binding = 2, r32f) uniform writeonly image2DArray terms;   // of half the size, from layer 1 on: curvature, b², (∇²V)², b Σb
layout(push_constant) uniform Constants {
    int width, height;
    float eta;
    float noise;                     // least deviation of a residual, intensities
    float least;                     // D below which it is rounding
};

// Pixels on either side over which b is summed.
const int REACH = 3;

float v_at(ivec2 x) {
    return imageLoad(relative_blur, ivec3(clamp(x, ivec2(0), ivec2(width, height) - 1), 0)).r;
}

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy), x = 2 * h;
    if (x.x >= width || x.y >= height) return;
    float d = imageLoad(normal_equations, ivec3(x, 0)).r, b = imageLoad(normal_equations, ivec3(x, 1)).r;
    bool determined = d > least;
    // b²/D is S²/ψ(S), from which S² follows; the second derivative of ψ is its weight times η²/(S² + η²).
    float pull = determined ? b * b / d : 0.0, square = 0.5 * pull * (pull + sqrt(pull * pull + 4.0 * eta * eta));
    imageStore(terms, ivec3(h, 1), vec4(determined ? d * eta * eta / (square + eta * eta) : 0.0));
    float rounding = noise * noise / eta * d;
    imageStore(terms, ivec3(h, 2), vec4(determined ? b * b + rounding : 0.0));
    // The divergence of central differences two pixels apart, which is insensitive to noise of single pixels.
    float around = v_at(x + ivec2(2, 0)) + v_at(x - ivec2(2, 0)) + v_at(x + ivec2(0, 2)) + v_at(x - ivec2(0, 2));
    float bend = 0.25 * around - v_at(x);
    imageStore(terms, ivec3(h, 3), vec4(bend * bend));
    ivec2 low = max(x - REACH, ivec2(0)), high = min(x + REACH, ivec2(width, height) - 1);
    float around_b = 0.0;
    for (int j = low.y; j <= high.y; j++) {
        for (int i = low.x; i <= high.x; i++) around_b += imageLoad(normal_equations, ivec3(i, j, 1)).r;
    }
    imageStore(terms, ivec3(h, 4), vec4(determined ? b * around_b + rounding : 0.0));
}
