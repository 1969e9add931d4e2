// Cells of 4 x 4 px at depth edges. Their numbers are in layers of `results` beyond V, its deviation and the residual:
// each cell has 16 floats in a layer, at its own pixels. CPU reference: src/engine/stages/edge.rs.

const int CELL = 4;                  // the side of a cell, pixels
// Layers: costs of the outlines with the near side in front, and with the far side in front; the edges; the
// distributions of the outline's place in both orders; the decisions. SIDES, per pixel near an accepted outline across
// which V changes sign: |V| of the front, positive in front, negative behind; 0 elsewhere. It stays for the fused
// image.
const int COSTS = 3, REVERSED_COSTS = 4, EDGES = 5, OUTLINES = 6, REVERSED_OUTLINES = 7, DECISIONS = 8, SIDES = 9;
// A coarser level uses the corner of the layers. These are its own:
// - the standard deviation; near accepted outlines it becomes the mean of both sides';
// - near accepted outlines: V of the far side; V of the near side is in the place of V;
// - how much V may change, 0 to 1, negative if the far side is in front; 0 elsewhere;
// - the probability that a pixel shows the near side, and its distance from where V was halfway, towards that side, px
//   of the level.
const int COARSE_DEVIATION = 10, COARSE_FAR = 11, COARSE_SHARE = 3, COARSE_NEAR = 4, COARSE_TOWARDS_NEAR = 12, LAYERS = 13;
// Displacements of an outline towards the side in front, px: from -BACKWARD on.
const int BACKWARD = 4, DISPLACEMENTS = 15;
// The cost of V as it is, behind those of the outlines.
const int BEFORE = DISPLACEMENTS;
// The sum of the shares of all pairs of frames in the costs, behind the edge: 1 for a pair.
const int TOTAL = 9;
// The place and the normal on the straightened edge and V of either side there, behind that.
const int STRAIGHT = 10;

// The cells with an edge are listed as edge_cells finds them, each by its column and, from this bit on, its row. Passes
// over the list have a workgroup for each: this many along x, and further ones along y. After the words of the
// workgroups over the list and over pixels comes the number of cells.
const int ROW_BIT = 16, ALONG_X = 32768, COUNT_PLACE = 6;

ivec3 place_of(ivec2 cell, int layer, int n) {
    return ivec3(CELL * cell + ivec2(n % CELL, n / CELL), layer);
}

float number_of(ivec2 cell, int layer, int n) {
    return imageLoad(results, place_of(cell, layer, n)).r;
}

// The edge of a cell: near is the side of the larger V. In a sweep V is u, in settings, and SIDES is not used.
struct Edge {
    bool exists;
    vec2 place;                      // where V is halfway, pixels
    vec2 normal;                     // towards the near side
    float near, far;                 // V of either side, px²
    float near_deviation, far_deviation;
};

// The edge of a cell, before it is straightened or after.
Edge edge_on(ivec2 cell, bool straight) {
    if (number_of(cell, EDGES, 0) == 0.0) return Edge(false, vec2(0.0), vec2(0.0), 0.0, 0.0, 0.0, 0.0);
    int line = straight ? STRAIGHT : 1, sides = straight ? STRAIGHT + 4 : 5;
    return Edge(true, vec2(number_of(cell, EDGES, line), number_of(cell, EDGES, line + 1)),
                vec2(number_of(cell, EDGES, line + 2), number_of(cell, EDGES, line + 3)), number_of(cell, EDGES, sides),
                number_of(cell, EDGES, sides + 1), number_of(cell, EDGES, 7), number_of(cell, EDGES, 8));
}

Edge edge_of(ivec2 cell) {
    return edge_on(cell, true);
}

// How far two cells lie on one edge, 0 to 1: by the angle between their normals. 0 if one is off the line of the other.
float agreement(Edge a, Edge b) {
    float along = dot(a.normal, b.normal);
    vec2 apart = b.place - a.place;
    float off = 0.5 * abs(dot(apart, a.normal + b.normal));
    return along < 0.7 || off > 2.0 + 0.25 * length(apart) ? 0.0 : along;
}

// Which side a pixel shows, 1 the near and 0 the far one, by the probability that it shows the near one. It shows one
// of them, not a V between. Only within 1/20 of a half it is mixed, so that rounding does not decide.
const float STEEPNESS = 10.0;

float shown_near(float probability) {
    return clamp(STEEPNESS * (probability - 0.5) + 0.5, 0.0, 1.0);
}

// The standard deviation of V around that of the side shown, as a share of the jump.
float deviation_between(float probability, float near) {
    probability = clamp(probability, 0.0, 1.0);
    return sqrt(probability * (1.0 - near) * (1.0 - near) + (1.0 - probability) * near * near);
}

// V passes from one side to the other over some 5 px. What stays on its side does not change beyond PASSED px, but by
// UNCHANGED, so that the fused image knows its side.
const float PASSED = 9.0, PASSING = 5.0, UNCHANGED = 0.001;

// How far V changes at a distance from where it was halfway, towards the near side, px, to V of the side shown, 0 to 1.
float change(float towards_near, float near) {
    float passes = clamp((PASSED - abs(towards_near)) / (PASSED - PASSING), UNCHANGED, 1.0);
    return mix(passes, 1.0, towards_near > 0.0 ? 1.0 - near : near);
}
