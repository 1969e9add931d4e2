// Draws V: blue where I1 is blurrier, orange where it is sharper, white at 0, black where V is NaN.

// V as bits, because WGSL has no NaN. V is the first field of the results; the others are not bound.
@group(0) @binding(0) var<storage, read> v: array<u32>;

override width: u32;
override range: f32; // |V| at which the colour saturates, px²

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
