// Accumulates residuals into Sums, and adds up those of a workgroup: within subgroups first, then over subgroups in
// order. Needs GL_KHR_shader_subgroup_arithmetic.

#include "sums.glsl"

// Sums over pixels of one column, by the powers of y: x is the same for all. 28 numbers in registers instead of 64.
// Vectors instead of an array: software devices keep arrays in memory.
struct Sums {
    vec3 n0, n1, n2, n3, n4;                            // w Jx², w Jx Jy, w Jy², times the power
    vec2 g0, g1, g2;                                    // w J S, times the power
    float energy, valid;
    vec2 roughness;                                     // √|b|, |∇V|
    float spread;                                       // of bounded squares of differences of S between adjacent pixels
    vec2 variance;                                      // b², D
};

Sums no_sums() {
    const vec3 n = vec3(0.0);
    const vec2 g = vec2(0.0);
    return Sums(n, n, n, n, n, g, g, g, 0.0, 0.0, g, 0.0, g);
}

// w J Jᵀ of a residual.
vec3 product(float w, vec2 j) {
    return w * vec3(j.x * j.x, j.x * j.y, j.y * j.y);
}

// Adds w J Jᵀ and w J S of a pixel. y is its place from the centre divided by L; `share` is the share by which it
// counts.
void add_pixel(inout Sums sums, vec3 n, vec2 g, float energy, float y, float share) {
    vec3 ny = y * n, nyy = y * ny;
    vec2 gy = y * g;
    sums.n0 += n;
    sums.n1 += ny;
    sums.n2 += nyy;
    sums.g0 += g;
    sums.g1 += gy;
    sums.energy += energy;
    sums.valid += share;
    if (!PROJECTIVE) return;
    sums.n3 += y * nyy;
    sums.n4 += y * y * nyy;
    sums.g2 += y * gy;
}

shared float by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][SUMS];

void reduce(int place, vec3 sums) {
    vec3 sum = subgroupAdd(sums);
    if (!subgroupElect()) return;
    for (int c = 0; c < 3; c++) by_subgroup[gl_SubgroupID][place + c] = sum[c];
}

void reduce(int place, vec2 sums) {
    vec2 sum = subgroupAdd(sums);
    if (!subgroupElect()) return;
    for (int c = 0; c < 2; c++) by_subgroup[gl_SubgroupID][place + c] = sum[c];
}

// The workgroup's sum n in invocation n < SUMS; zero in the others. x is the place of the invocation's column.
float workgroup_sum(Sums sums, float x) {
    vec3 nx = x * sums.n0, nxx = x * nx, nxy = x * sums.n1;
    vec2 gx = x * sums.g0;
    reduce(0, sums.n0);
    reduce(3, nx);
    reduce(6, sums.n1);
    reduce(9, nxx);
    reduce(12, nxy);
    reduce(15, sums.n2);
    reduce(GRADIENT, sums.g0);
    reduce(GRADIENT + 2, gx);
    reduce(GRADIENT + 4, sums.g1);
    if (PROJECTIVE) {
        vec3 nxxx = x * nxx, nxxy = x * nxy, nxyy = x * sums.n2;
        reduce(18, nxxx);
        reduce(21, nxxy);
        reduce(24, nxyy);
        reduce(27, sums.n3);
        reduce(30, x * nxxx);
        reduce(33, x * nxxy);
        reduce(36, x * nxyy);
        reduce(39, x * sums.n3);
        reduce(42, sums.n4);
        reduce(GRADIENT + 6, x * gx);
        reduce(GRADIENT + 8, x * sums.g1);
        reduce(GRADIENT + 10, sums.g2);
    }
    reduce(ENERGY, vec2(sums.energy, sums.valid));
    reduce(ROUGHNESS, vec3(sums.roughness, sums.spread));
    reduce(VARIANCE, sums.variance);
    barrier();
    uint n = gl_LocalInvocationIndex;
    float sum = 0.0;
    if (n > VARIANCE + 1) return sum;
    for (uint group = 0; group < gl_NumSubgroups; group++) sum += by_subgroup[group][n];
    return sum;
}
