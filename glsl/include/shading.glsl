// How much brighter I1 is than I2 from place to place: a polynomial of fourth degree in the place on I2, 1 on average, stated by
// Legendre polynomials. Twin: src/base/shading.rs.

// Beside the constant term, which is 1.
const int TERMS = 14;

// Of degree 0 to 4.
void legendre(float x, out float p[5]) {
    float s = x * x;
    p = float[](1.0, x, 1.5 * s - 0.5, (2.5 * s - 1.5) * x, (4.375 * s - 3.75) * s + 0.375);
}

// The degrees along x and y of a term, by their sum: 1, x, y, xx, xy, yy, xxx, ...
ivec2 degrees(int term) {
    int sum = term < 1 ? 0 : term < 3 ? 1 : term < 6 ? 2 : term < 10 ? 3 : 4;
    int y = term - sum * (sum + 1) / 2;
    return ivec2(sum - y, y);
}

// At a place from the centre, -1 to 1 along either side; what the photographs do not show it may not make of itself.
float shading_at(float coefficients[TERMS], vec2 place) {
    float px[5], py[5], sum = 1.0;
    legendre(place.x, px);
    legendre(place.y, py);
    for (int n = 0; n < TERMS; n++) {
        ivec2 d = degrees(n + 1);
        sum += coefficients[n] * px[d.x] * py[d.y];
    }
    return clamp(sum, 0.25, 4.0);
}
