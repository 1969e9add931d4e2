// A term of the uncertainty at a pixel, from the terms on every other pixel. `terms` is the includer's image. CPU
// reference: src/engine/stages/uncertainty_terms.rs.

float term(int layer, ivec2 x, ivec2 size) {
    ivec2 low = x / 2, high = min((x + 1) / 2, (size - 1) / 2);
    return 0.25 * (imageLoad(terms, ivec3(low, layer)).r + imageLoad(terms, ivec3(high.x, low.y, layer)).r
                   + imageLoad(terms, ivec3(low.x, high.y, layer)).r + imageLoad(terms, ivec3(high, layer)).r);
}
