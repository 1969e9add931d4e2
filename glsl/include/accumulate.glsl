// Accumulates residuals into Sums and adds up those of a workgroup, subgroups first, then theirs in order. Needs
// GL_KHR_shader_subgroup_arithmetic.

#include "sums.glsl"

// ∂S/∂(displacement, gain at intensity ½, offset) of a residual, up to its sign. What the six unknowns do follows from it and
// the place alone, since a and b displace a pixel by (x, y) and (-y, x).
vec4 jacobian(float gain, float value, vec2 gradient) {
    return vec4(gain * gradient, value - 0.5, 1.0);
}

// Σ w J Jᵀ of some residuals, upper triangle.
struct Products {
    vec4 x;                          // of the displacement to the right with all four
    vec3 y;
    vec2 gain;
    float offset;
};

Products product(float w, vec4 j) {
    vec4 wj = w * j;
    return Products(wj.x * j, wj.y * j.yzw, wj.z * j.zw, wj.w * j.w);
}

Products add(Products a, Products b) {
    return Products(a.x + b.x, a.y + b.y, a.gain + b.gain, a.offset + b.offset);
}

// Adds Σ w J Jᵀ and Σ w J S of a pixel at p from the centre, over the length that scales a and b; `share` is what it
// counts for.
void add_pixel(inout Sums sums, Products n, vec4 g, float energy, vec2 p, float share) {
    vec2 turned = vec2(-p.y, p.x);
    mat2 by_place = mat2(n.x.x, n.x.y, n.x.y, n.y.x);
    vec2 a = by_place * p, b = by_place * turned;
    vec2 gain = vec2(n.x.z, n.y.y), offset = vec2(n.x.w, n.y.z);
    sums.n00 += vec4(dot(p, a), dot(turned, a), a);
    sums.n04 += vec4(dot(p, gain), dot(p, offset), dot(turned, b), b.x);
    sums.n13 += vec4(b.y, dot(turned, gain), dot(turned, offset), n.x.x);
    sums.n23 += vec4(n.x.yzw, n.y.x);
    sums.n34 += vec4(n.y.yz, n.gain);
    sums.n55 += vec4(n.offset, dot(p, g.xy), dot(turned, g.xy), g.x);
    sums.g3 += vec4(g.yzw, energy);
    sums.valid.x += share;
}

shared vec4 by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][SUMS / 4];

void reduce(int n, vec4 sums) {
    vec4 sum = subgroupAdd(sums);
    if (subgroupElect()) by_subgroup[gl_SubgroupID][n] = sum;
}

// The workgroup's sum n in invocation n < SUMS; zero in the others.
float workgroup_sum(Sums sums) {
    reduce(0, sums.n00);
    reduce(1, sums.n04);
    reduce(2, sums.n13);
    reduce(3, sums.n23);
    reduce(4, sums.n34);
    reduce(5, sums.n55);
    reduce(6, sums.g3);
    reduce(7, sums.valid);
    barrier();
    uint n = gl_LocalInvocationIndex;
    float sum = 0.0;
    if (n >= SUMS) return sum;
    for (uint group = 0; group < gl_NumSubgroups; group++) sum += by_subgroup[group][n / 4][n % 4];
    return sum;
}
