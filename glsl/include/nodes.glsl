// Where the nodes of a stack lie, and how a disk departs from a Gaussian there. Twin: src/engine/stages/stack.rs.

float node_variance(int k) {
    float sigma = k <= 3 ? 0.5 * float(k) : 1.5 * pow(4.0 / 3.0, float(k - 3));
    return sigma * sigma;
}

// The disk of variance v less the Gaussian of the same, from Gaussians of three variances about v: -0.55 v² times their second
// divided difference.
float departure(float v, vec3 variances, vec3 values) {
    vec2 rises = (values.yz - values.xy) / (variances.yz - variances.xy);
    return -0.55 * v * v * (rises.y - rises.x) / (variances.z - variances.x);
}

// The first of the three nodes that a node's departure is made from.
int departs_from(int k, int count) {
    return min(k, count - 2) - 1;
}
