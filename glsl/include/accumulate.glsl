// Accumulates residuals into Sums, and adds up those of a workgroup: within subgroups first, then over subgroups in
// order. Needs GL_KHR_shader_subgroup_arithmetic.

#include "sums.glsl"

// Vectors instead of an array: software devices keep arrays in memory.
struct Sums {
    vec3 n1, nx, ny, nxx, nxy, nyy;                     // w Jx², w Jx Jy, w Jy², times the monomial
    vec3 nxxx, nxxy, nxyy, nyyy, nxxxx, nxxxy, nxxyy, nxyyy, nyyyy;
    vec2 g1, gx, gy, gxx, gxy, gyy;                     // w J S, times the monomial
    float energy, valid;
    vec2 roughness;                                     // √|b|, |∇V|
    float spread;                                      // of bounded squares of differences of S between adjacent pixels
    vec2 variance;                                      // b², D
};

Sums no_sums() {
    const vec3 n = vec3(0.0);
    const vec2 g = vec2(0.0);
    return Sums(n, n, n, n, n, n, n, n, n, n, n, n, n, n, n, g, g, g, g, g, g, 0.0, 0.0, g, 0.0, g);
}

// w J Jᵀ of a residual.
vec3 product(float w, vec2 j) {
    return w * vec3(j.x * j.x, j.x * j.y, j.y * j.y);
}

// Adds w J Jᵀ and w J S of a pixel. p is its place from the centre divided by L; `share` is the share by which it
// counts.
void add_pixel(inout Sums sums, vec3 n, vec2 g, float energy, vec2 p, float share) {
    vec3 nx = p.x * n, ny = p.y * n, nxx = p.x * nx, nxy = p.x * ny, nyy = p.y * ny;
    vec2 gx = p.x * g, gy = p.y * g;
    sums.n1 += n;
    sums.nx += nx;
    sums.ny += ny;
    sums.nxx += nxx;
    sums.nxy += nxy;
    sums.nyy += nyy;
    sums.g1 += g;
    sums.gx += gx;
    sums.gy += gy;
    sums.energy += energy;
    sums.valid += share;
    if (!PROJECTIVE) return;
    vec3 nxxx = p.x * nxx, nxxy = p.y * nxx, nxyy = p.x * nyy, nyyy = p.y * nyy;
    sums.nxxx += nxxx;
    sums.nxxy += nxxy;
    sums.nxyy += nxyy;
    sums.nyyy += nyyy;
    sums.nxxxx += p.x * nxxx;
    sums.nxxxy += p.y * nxxx;
    sums.nxxyy += p.x * nxyy;
    sums.nxyyy += p.x * nyyy;
    sums.nyyyy += p.y * nyyy;
    sums.gxx += p.x * gx;
    sums.gxy += p.x * gy;
    sums.gyy += p.y * gy;
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

// The workgroup's sum n in invocation n < SUMS; zero in the others.
float workgroup_sum(Sums sums) {
    reduce(0, sums.n1);
    reduce(3, sums.nx);
    reduce(6, sums.ny);
    reduce(9, sums.nxx);
    reduce(12, sums.nxy);
    reduce(15, sums.nyy);
    reduce(GRADIENT, sums.g1);
    reduce(GRADIENT + 2, sums.gx);
    reduce(GRADIENT + 4, sums.gy);
    if (PROJECTIVE) {
        reduce(18, sums.nxxx);
        reduce(21, sums.nxxy);
        reduce(24, sums.nxyy);
        reduce(27, sums.nyyy);
        reduce(30, sums.nxxxx);
        reduce(33, sums.nxxxy);
        reduce(36, sums.nxxyy);
        reduce(39, sums.nxyyy);
        reduce(42, sums.nyyyy);
        reduce(GRADIENT + 6, sums.gxx);
        reduce(GRADIENT + 8, sums.gxy);
        reduce(GRADIENT + 10, sums.gyy);
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
