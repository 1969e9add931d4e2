// What the registration step sums over the valid pixels. Twin: src/stages/linearise.rs.

const int GRADIENT = 21;             // after the upper triangle of N by rows
const int ENERGY = 27;
const int VALID = 28;
const int SUMS = 29;
