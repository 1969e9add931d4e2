// A grid of the cascade: an equation (D, r, weights of the right and of the lower neighbour) for each cell. CPU
// reference: src/engine/stages/grid.rs.

ivec2 halved(ivec2 size) { return (size + 1) / 2; }

// The equation of a coarse cell from those of its four cells, by rows. D and r add up. A link across the border is as
// wide as two, and twice as long.
vec4 sum_of(vec4 left, vec4 right, vec4 left_below, vec4 right_below) {
    vec2 dr = left.xy + right.xy + left_below.xy + right_below.xy;
    return vec4(dr, 0.5 * (right.z + right_below.z), 0.5 * (left_below.w + right_below.w));
}
