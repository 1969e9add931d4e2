// By how much each photograph is blurred for a relative blur V. CPU reference: src/engine/stages/law.rs.

// The range of V around 0 in which both images are blurred, px².
const float EPSILON = 0.1;

// The variances by which I1 and I2 are blurred so that both look alike, and their derivatives by V.
struct Variances {
    float first, second;
    float first_by_v, second_by_v;
};

// `separation` is that of the two focus settings, p, in px² of the level. At 0 the sharper image alone is blurred.
Variances variances_at(float v, float separation) {
    if (separation > 0.0) {
        float quarter = 0.25 / separation, by_v = 0.5 / separation, sum = v + separation, difference = v - separation;
        return Variances(quarter * sum * sum, quarter * difference * difference, by_v * sum, by_v * difference);
    }
    float root = sqrt(v * v + EPSILON * EPSILON), larger = 0.5 * (abs(v) + root), along = v / root;
    float smaller = 0.25 * EPSILON * EPSILON / larger;
    return Variances(v >= 0.0 ? larger : smaller, v >= 0.0 ? smaller : larger, 0.5 + 0.5 * along, 0.5 * along - 0.5);
}
