// Accumulates residuals into Sums and adds up those of a workgroup, subgroups first, then theirs in order. Needs
// GL_KHR_shader_subgroup_arithmetic.

#include "sums.glsl"

// ∂S/∂ζ of a residual, up to its sign: by a L, b L, tx, ty; by gain, offset.
struct Jacobian {
    vec4 transform;
    vec2 photometric;
};

// Of gain times a value of I2 with that gradient, p from the centre; `length` scales a and b.
Jacobian jacobian(float gain, float value, vec2 gradient, vec2 p, float length) {
    vec2 g = gain * gradient;
    return Jacobian(vec4(dot(g, p) / length, (g.y * p.x - g.x * p.y) / length, g), vec2(value - 0.5, 1.0));
}

// Adds w J Jᵀ to N.
void add_product(inout Sums sums, float w, Jacobian j) {
    vec4 weighted = w * j.transform;
    sums.transform += outerProduct(j.transform, weighted);
    sums.gain += j.photometric.x * weighted;
    sums.offset += j.photometric.y * weighted;
    sums.photometric.xyz += w * vec3(j.photometric.x * j.photometric, j.photometric.y * j.photometric.y);
}

// Adds w J to g.
void add_gradient(inout Sums sums, float w, Jacobian j) {
    sums.g_transform += w * j.transform;
    sums.g_photometric.xy += w * j.photometric;
}

shared vec4 by_subgroup[gl_WorkGroupSize.x * gl_WorkGroupSize.y / 4][SUMS / 4];

void reduce(int n, vec4 sums) {
    vec4 sum = subgroupAdd(sums);
    if (subgroupElect()) by_subgroup[gl_SubgroupID][n] = sum;
}

// The workgroup's sum n in invocation n < SUMS; zero in the others.
float workgroup_sum(Sums sums) {
    for (int n = 0; n < 4; n++) reduce(n, sums.transform[n]);
    reduce(GAIN / 4, sums.gain);
    reduce(OFFSET / 4, sums.offset);
    reduce(PHOTOMETRIC / 4, sums.photometric);
    reduce(G_TRANSFORM / 4, sums.g_transform);
    reduce(G_PHOTOMETRIC / 4, sums.g_photometric);
    barrier();
    uint n = gl_LocalInvocationIndex;
    float sum = 0.0;
    if (n >= SUMS) return sum;
    for (uint group = 0; group < gl_NumSubgroups; group++) sum += by_subgroup[group][n / 4][n % 4];
    return sum;
}
