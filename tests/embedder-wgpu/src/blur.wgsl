// V in colours: blue where I1 is the softer, orange where it is the sharper, white between, black where nothing is known.

// Bits, since WGSL knows no NaN. V is first: what follows is not bound.
@group(0) @binding(0) var<storage, read> v: array<u32>;

override width: u32;
override range: f32; // V that has the full colour, px²

// A triangle that covers the screen.
@vertex
fn screen(@builtin(vertex_index) n: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(n & 1u), f32(n >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn blur(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let bits = v[u32(place.y) * width + u32(place.x)];
    if (bits & 0x7fffffffu) > 0x7f800000u {
        return vec4f(0.0, 0.0, 0.0, 1.0);
    }
    let part = clamp(bitcast<f32>(bits) / range, -1.0, 1.0);
    let end = select(vec3f(0.9, 0.5, 0.1), vec3f(0.1, 0.3, 0.8), part < 0.0);
    return vec4f(mix(vec3f(1.0), end, abs(part)), 1.0);
}
