// The sums of the registration step over the valid pixels: three of w ∇J ∇Jᵀ for each monomial of the place, two of w
// ∇J S; the energy; the valid pixels. N and g follow from these for all unknowns that displace a pixel by polynomials
// of its place. CPU reference: src/engine/stages/sums.rs.
//
// Monomials are 1, x, y, xx, xy, yy and so on, with x and y from the centre divided by L. Homographies displace by
// those of second degree, so that N has those of fourth.

layout(constant_id = 5) const bool PROJECTIVE = false;

const int MONOMIALS = PROJECTIVE ? 15 : 6;
const int GRADIENT_MONOMIALS = PROJECTIVE ? 6 : 3;
const int GRADIENT = 3 * MONOMIALS;
const int ENERGY = GRADIENT + 2 * GRADIENT_MONOMIALS;
const int VALID = ENERGY + 1;
const int ROUGHNESS = VALID + 1;     // of √|b|; then of |∇V|
const int SPREAD = ROUGHNESS + 2;    // of bounded squares of differences of S between adjacent pixels
const int VARIANCE = SPREAD + 1;     // of b²; then of D
const int SUMS = PROJECTIVE ? 64 : 32;

// The unknowns of T's step: t; zoom and turn; stretch and shear; g. A translation has the first two, a similarity four,
// an affine map six, a homography all. Each displaces a pixel at (x, y) by (±) one monomial along x and one along y:
// (1, 0), (0, 1); (x, y), (-y, x); (x, -y), (y, x); (-xx, -xy), (-xy, -yy).
const int UNKNOWNS = PROJECTIVE ? 8 : 6;
const ivec2 SIGNS[8] = ivec2[](ivec2(1, 0), ivec2(0, 1), ivec2(1, 1), ivec2(-1, 1), ivec2(1, -1), ivec2(1, 1), ivec2(-1, -1),
                               ivec2(-1, -1));
const ivec4 POWERS[8] = ivec4[](ivec4(0), ivec4(0), ivec4(1, 0, 0, 1), ivec4(0, 1, 1, 0), ivec4(1, 0, 0, 1),
                                ivec4(0, 1, 1, 0), ivec4(2, 0, 1, 1), ivec4(1, 1, 0, 2)); // of x and y, along x, y

// The index of a monomial.
int monomial(ivec2 powers) {
    int degree = powers.x + powers.y;
    return degree * (degree + 1) / 2 + powers.y;
}

ivec2 powers_of(int unknown, int axis) {
    return axis == 0 ? POWERS[unknown].xy : POWERS[unknown].zw;
}

// The step that follows the sums.
struct Step {
    int level;
    int energy_place;                // of this level and iteration
    int unknowns;                    // the number of unknowns of T to solve for
    int flags;
    float still;                     // a level settles only if no corner moves by more, pixels of the level
    float share;                     // of the step that is taken
    float steady;                    // or its step by less than a share of T's deviation: x N x over Σ b² / Σ D,
    float steady_by_tiles;           // or over the variance of the gradient by tiles
    float flatness;                  // a level settles only if the energy changes by no more than this share
    float most_moving;               // a level settles only if the latest step moved at most this share of the pixels,
    float most_far;                  // and no more than this share far
    float least_spread;              // noise for which η of the weights is wide enough
};
// Its flags: the last workgroup of the pass that makes the sums takes the step; it descends the gradient instead of
// solving; α has its final value; it finds α; the next iteration may warp I2 again.
const int STEPS = 1, DESCENDS = 2, MAY_SETTLE = 4, FINDS_ALPHA = 8, MAY_WARP = 16;
