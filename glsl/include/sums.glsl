// What the registration step sums over the valid pixels, as the rows of nine vec4. Twin: Sums in src/stages/linearise.rs.
//
// Vectors and no arrays: software devices keep arrays in memory.

const int SUMS = 36;

struct Sums {
    mat4 transform;       // N between a L, b L, tx, ty
    vec4 gain, offset;    // N between these and gain, offset
    vec4 photometric;     // N between gain and gain, gain and offset, offset and offset; the energy
    vec4 g_transform;     // g
    vec4 g_photometric;   // g of gain and offset; valid pixels; nothing
};

const int GAIN = 16;
const int OFFSET = 20;
const int PHOTOMETRIC = 24;
const int ENERGY = 27;
const int G_TRANSFORM = 28;
const int G_PHOTOMETRIC = 32;
const int VALID = 34;
