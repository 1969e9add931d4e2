#version 460
// V in colours: blue where I1 is the softer, orange where it is the sharper, white between, black where nothing is known.

// Bits, since shaders need not tell NaN from numbers. V is first: what follows is not read.
layout(set = 0, binding = 0) readonly buffer Results { uint v[]; };
layout(push_constant) uniform Constants {
    uint width;
    float range; // V that has the full colour, px²
};
layout(location = 0) out vec4 colour;

void main() {
    uint bits = v[uint(gl_FragCoord.y) * width + uint(gl_FragCoord.x)];
    float part = clamp(uintBitsToFloat(bits) / range, -1.0, 1.0);
    vec3 end = part < 0.0 ? vec3(0.1, 0.3, 0.8) : vec3(0.9, 0.5, 0.1);
    bool unknown = (bits & 0x7fffffffu) > 0x7f800000u;
    colour = vec4(unknown ? vec3(0.0) : mix(vec3(1.0), end, abs(part)), 1.0);
}
