// The variances of the nodes of a blur stack, and the departure of a disk from a Gaussian. CPU reference:
// src/engine/stages/stack.rs.

float node_variance(int k) {
    float sigma = k <= 3 ? 0.5 * float(k) : 1.5 * pow(4.0 / 3.0, float(k - 3));
    return sigma * sigma;
}

// The difference between the disk and the Gaussian of variance v, from Gaussians of three variances about v: -0.55 v²
// times their second divided difference.
float departure(float v, vec3 variances, vec3 values) {
    vec2 rises = (values.yz - values.xy) / (variances.yz - variances.xy);
    return -0.55 * v * v * (rises.y - rises.x) / (variances.z - variances.x);
}

// The first of the three nodes that determine a node's departure.
int departs_from(int k, int count) {
    return min(k, count - 2) - 1;
}
