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

// The spline at pixel i plus a fraction f of a pixel, which are separate since their sum loses digits at large i.
Jet spline_at(int image, int layer, ivec2 size, ivec2 i, vec2 f) {
    vec2 u = 1.0 - f;
    vec2 w[4] = vec2[](u * u * u / 6.0, 2.0 / 3.0 - f * f + 0.5 * f * f * f, 2.0 / 3.0 - u * u + 0.5 * u * u * u,
                       f * f * f / 6.0);
    vec2 d[4] = vec2[](-0.5 * u * u, 1.5 * f * f - 2.0 * f, 2.0 * u - 1.5 * u * u, 0.5 * f * f);
    vec2 dd[4] = vec2[](u, 3.0 * f - 2.0, 3.0 * u - 2.0, f);
    ivec2 taps[4] = ivec2[](reflect_once(i - 1, size), reflect_once(i, size), reflect_once(i + 1, size),
                            reflect_once(i + 2, size));
    Jet jet = Jet(0.0, vec2(0.0), 0.0);
    for (int row = 0; row < 4; row++) {
        vec3 line = vec3(0.0);
        for (int column = 0; column < 4; column++) {
            float c = coefficient(image, ivec3(taps[column].x, taps[row].y, layer));
            line += vec3(w[column].x, d[column].x, dd[column].x) * c;
        }
        jet.value += w[row].y * line.x;
        jet.gradient += vec2(w[row].y * line.y, d[row].y * line.x);
        jet.laplacian += w[row].y * line.z + dd[row].y * line.x;
    }
    float unit = unit_of_coefficients();
    return Jet(unit * jet.value, unit * jet.gradient, unit * jet.laplacian);
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
