// Cubic B-splines over the coefficients in one layer of an image. CPU reference: src/engine/stages/spline.rs.

#include "border.glsl"
#include "stacks.glsl"

// Each shader defines which image a number means, since images cannot be arguments, and the unit of the coefficients.
float coefficient(int image, ivec3 place);
float unit_of_coefficients();

struct Jet {
    float value;
    vec2 gradient;
    float laplacian;
};

// Value, first and second derivative of a spline of one variable, by the coefficients before and after a fraction of a
// pixel. Differences of coefficients instead of twelve weights, which would take registers.
vec3 spline_along(vec4 c, float f) {
    vec3 rise = c.yzw - c.xyz;
    float bent = rise.y - rise.x, second = bent + f * (rise.z - rise.y - bent), start = 0.5 * (rise.x + rise.y);
    float value = c.y + bent / 6.0 + f * (start + f * (2.0 * bent + second) / 6.0);
    return vec3(value, start + 0.5 * f * (bent + second), second);
}

// The spline at pixel i plus a fraction f of a pixel, which are separate since their sum loses digits at large i.
Jet spline_at(int image, int layer, ivec2 size, ivec2 i, vec2 f) {
    ivec2 taps[4] = ivec2[](reflect_once(i - 1, size), reflect_once(i, size), reflect_once(i + 1, size),
                            reflect_once(i + 2, size));
    vec4 values, slopes, seconds;
    for (int row = 0; row < 4; row++) {
        vec4 c;
        for (int column = 0; column < 4; column++) c[column] = coefficient(image, ivec3(taps[column].x, taps[row].y, layer));
        vec3 line = spline_along(c, f.x);
        values[row] = line.x;
        slopes[row] = line.y;
        seconds[row] = line.z;
    }
    vec3 column = spline_along(values, f.y);
    vec2 gradient = vec2(spline_along(slopes, f.y).x, column.y);
    float unit = unit_of_coefficients();
    return Jet(unit * column.x, unit * gradient, unit * (spline_along(seconds, f.y).x + column.z));
}

// The nine coefficients around a pixel, which determine the spline on the pixel itself.
struct Stencil {
    vec3 above, here, below;         // from left to right
};

Stencil stencil(int image, int layer, ivec3 columns, ivec3 lines) {
    Stencil s;
    for (int n = 0; n < 3; n++) {
        s.above[n] = coefficient(image, ivec3(columns[n], lines.x, layer));
        s.here[n] = coefficient(image, ivec3(columns[n], lines.y, layer));
        s.below[n] = coefficient(image, ivec3(columns[n], lines.z, layer));
    }
    return s;
}

// The spline at a small shift from the pixel, to first order. Second order would remove noise with the shift, all over
// the image, and T would drift.
Jet spline_near(Stencil s, vec2 shift) {
    float sixth = (1.0 / 6.0) * unit_of_coefficients();
    vec3 sum = s.above + s.below;
    vec3 smoothed = sixth * (sum + 4.0 * s.here), rise = 0.5 * (s.below - s.above), bent = sum - 2.0 * s.here;
    vec2 gradient = vec2(0.5 * (smoothed.z - smoothed.x), sixth * (rise.x + rise.z + 4.0 * rise.y));
    float value = (smoothed.x + smoothed.z + 4.0 * smoothed.y) / 6.0;
    return Jet(value + dot(gradient, shift), gradient,
               smoothed.x + smoothed.z - 2.0 * smoothed.y + sixth * (bent.x + bent.z + 4.0 * bent.y));
}
