#version 460
// One red or black half-iteration on the linear system for dV. Twin: src/stages/relax.rs.
//
// Red and black stand apart in half-width images, so that a missing barrier between two half-iterations can be seen.

layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, r32f) uniform readonly image2DArray right_sides; // layer 0: red, layer 1: black
layout(binding = 1, rgba32f) uniform readonly image2DArray weights;  // likewise; right, left, down, up
layout(binding = 2, r32f) uniform readonly image2DArray other;  // dV of the other colour
layout(binding = 3, r32f) uniform image2DArray own;             // dV of this colour
layout(constant_id = 2) const bool FIRST = false;               // sweep: dV is zero, of black too while it is red's turn
layout(push_constant) uniform Constants {
    int width, height;
    int color;                                                  // 0 red: x + y even
    float over_relaxation;
};

void main() {
    ivec2 h = ivec2(gl_GlobalInvocationID.xy);
    int odd = h.y + color & 1;
    if (2 * h.x + odd >= width || h.y >= height) return;
    ivec3 place = ivec3(h, color);
    float target = imageLoad(right_sides, place).r, before = 0.0;
    if (!FIRST || color == 1) {
        // Weights across the border are zero; the index has only to exist.
        int right = min(h.x + odd, (width - 1) / 2), left = max(h.x + odd - 1, 0);
        int down = min(h.y + 1, height - 1), up = max(h.y - 1, 0);
        vec4 around = vec4(imageLoad(other, ivec3(right, h.y, 0)).r, imageLoad(other, ivec3(left, h.y, 0)).r,
                           imageLoad(other, ivec3(h.x, down, 0)).r, imageLoad(other, ivec3(h.x, up, 0)).r);
        target += dot(imageLoad(weights, place), around);
    }
    if (!FIRST) before = imageLoad(own, ivec3(h, 0)).r;
    imageStore(own, ivec3(h, 0), vec4(mix(before, target, over_relaxation)));
}
