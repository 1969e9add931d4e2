// Reads the equations of a grid. Included after the buffer `equations`.

#include "grid.glsl"

// The equation of a cell of the next coarser grid. `first` is the first cell of the finer grid.
vec4 coarse_equation(int first, ivec2 size, ivec2 cell) {
    vec4 of[4];
    for (int n = 0; n < 4; n++) {
        ivec2 x = 2 * cell + ivec2(n & 1, n >> 1);
        of[n] = all(lessThan(x, size)) ? equations[first + x.y * size.x + x.x] : vec4(0.0);
    }
    return sum_of(of[0], of[1], of[2], of[3]);
}

// The weights of the right, left, lower and upper neighbour of a cell; 0 across the border.
vec4 links_at(int place, ivec2 x, int width) {
    vec4 own = equations[place];
    return vec4(own.z, x.x > 0 ? equations[place - 1].z : 0.0, own.w, x.y > 0 ? equations[place - width].w : 0.0);
}
