// The brightness of I1 relative to I2: a polynomial of fourth degree in the place on I2, 1 on average, in Legendre
// polynomials. CPU reference: src/base/shading.rs.

// Without the constant term, which is 1.
const int TERMS = 14;

// The Legendre polynomials of degree 0 to 4.
void legendre(float x, out float p[5]) {
    float s = x * x;
    p = float[](1.0, x, 1.5 * s - 0.5, (2.5 * s - 1.5) * x, (4.375 * s - 3.75) * s + 0.375);
}

// The degrees along x and y of a term, sorted by their sum: 1, x, y, xx, xy, yy, xxx, ...
ivec2 degrees(int term) {
    int sum = term < 1 ? 0 : term < 3 ? 1 : term < 6 ? 2 : term < 10 ? 3 : 4;
    int y = term - sum * (sum + 1) / 2;
    return ivec2(sum - y, y);
}

// At a place from the centre, -1 to 1 along either side. Clamped, since the polynomial is not determined beyond the
// photographs.
float shading_at(float coefficients[TERMS], vec2 place) {
    float x[5], y[5], c[TERMS] = coefficients;
    legendre(place.x, x);
    legendre(place.y, y);
    // Unrolled, in the order of `degrees`: software devices gather indexed values.
    float by_x = (c[0] + c[3] * y[1] + c[7] * y[2] + c[12] * y[3]) * x[1];
    float by_xx = (c[2] + c[6] * y[1] + c[11] * y[2]) * x[2], by_xxx = (c[5] + c[10] * y[1]) * x[3];
    float alone = c[1] * y[1] + c[4] * y[2] + c[8] * y[3] + c[13] * y[4] + c[9] * x[4];
    return clamp(1.0 + by_x + by_xx + by_xxx + alone, 0.25, 4.0);
}
