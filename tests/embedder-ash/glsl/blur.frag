#version 460
// Draws V: blue where I1 is blurrier, orange where it is sharper, white at 0, black where V is NaN.

// V as bits, because shaders need not support NaN. V is the first field of the results; the others are not read.
layout(set = 0, binding = 0) readonly buffer Results { uint v[]; };
layout(push_constant) uniform Constants {
    uint width;
    float range; // |V| at which the colour saturates, px²
};
layout(location = 0) out vec4 colour;

void main() {
    uint bits = v[uint(gl_FragCoord.y) * width + uint(gl_FragCoord.x)];
    float part = clamp(uintBitsToFloat(bits) / range, -1.0, 1.0);
    vec3 end = part < 0.0 ? vec3(0.1, 0.3, 0.8) : vec3(0.9, 0.5, 0.1);
    bool is_nan = (bits & 0x7fffffffu) > 0x7f800000u;
    colour = vec4(is_nan ? vec3(0.0) : mix(vec3(1.0), end, abs(part)), 1.0);
}
