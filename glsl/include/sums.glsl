// What the registration step sums over the valid pixels: of w ∇J ∇Jᵀ three numbers times each monomial of the place, of
// w ∇J S two; the energy; the valid pixels. Whatever unknowns displace a pixel by polynomials of its place, N and g are made
// of these. Twin: src/engine/stages/sums.rs.
//
// Monomials 1, x, y, xx, xy, yy, and so on, x and y from the centre over a length. Homographies displace by those of
// second degree, so that N has those of fourth.

layout(constant_id = 5) const bool PROJECTIVE = false;

const int MONOMIALS = PROJECTIVE ? 15 : 6;
const int GRADIENT_MONOMIALS = PROJECTIVE ? 6 : 3;
const int GRADIENT = 3 * MONOMIALS;
const int ENERGY = GRADIENT + 2 * GRADIENT_MONOMIALS;
const int VALID = ENERGY + 1;
const int ROUGHNESS = VALID + 1;     // of √|b|; then of |∇V|
const int SPREAD = ROUGHNESS + 2;    // of bounded squares of how S differs from pixel to pixel
const int SUMS = PROJECTIVE ? 64 : 32;

// The unknowns of T's step: t; zoom and turn; stretch and shear; g. A translation has the first two of them, a similarity
// four, an affine map six, a homography all. Each displaces a pixel at (x, y) by (±) one monomial along x and one along y:
// (1, 0), (0, 1); (x, y), (-y, x); (x, -y), (y, x); (-xx, -xy), (-xy, -yy).
const int UNKNOWNS = PROJECTIVE ? 8 : 6;
const ivec2 SIGNS[8] = ivec2[](ivec2(1, 0), ivec2(0, 1), ivec2(1, 1), ivec2(-1, 1), ivec2(1, -1), ivec2(1, 1), ivec2(-1, -1),
                               ivec2(-1, -1));
const ivec4 POWERS[8] = ivec4[](ivec4(0), ivec4(0), ivec4(1, 0, 0, 1), ivec4(0, 1, 1, 0), ivec4(1, 0, 0, 1),
                                ivec4(0, 1, 1, 0), ivec4(2, 0, 1, 1), ivec4(1, 1, 0, 2));   // of x and y, along x, along y

// Where a monomial stands among all.
int monomial(ivec2 powers) {
    int degree = powers.x + powers.y;
    return degree * (degree + 1) / 2 + powers.y;
}

ivec2 powers_of(int unknown, int axis) {
    return axis == 0 ? POWERS[unknown].xy : POWERS[unknown].zw;
}
