// Cubic B-splines over the coefficients in one layer of an image. Twin: src/stages/spline.rs.

// Each shader says which of its images a number means, since an image of a format cannot be an argument.
float coefficient(int image, ivec3 place);

#include "border.glsl"

struct Jet {
    float value;
    vec2 gradient;
    float laplacian;
};

// The spline at pixel i plus a fraction f of a pixel: kept apart, since their sum loses digits at large i.
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
    return jet;
}

// The spline on pixel i itself: nine coefficients instead of sixteen, and no gradient.
Jet spline_on(int image, int layer, ivec2 size, ivec2 i) {
    ivec2 before = reflect_once(i - 1, size), after = reflect_once(i + 1, size);
    float centre = coefficient(image, ivec3(i, layer));
    float sides = coefficient(image, ivec3(before.x, i.y, layer))
                + coefficient(image, ivec3(after.x, i.y, layer))
                + coefficient(image, ivec3(i.x, before.y, layer))
                + coefficient(image, ivec3(i.x, after.y, layer));
    float corners = coefficient(image, ivec3(before.x, before.y, layer))
                  + coefficient(image, ivec3(after.x, before.y, layer))
                  + coefficient(image, ivec3(before.x, after.y, layer))
                  + coefficient(image, ivec3(after.x, after.y, layer));
    return Jet((16.0 * centre + 4.0 * sides + corners) / 36.0, vec2(0.0),
               (-8.0 * centre + sides + corners) / 3.0);
}
