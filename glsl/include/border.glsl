// The border rule of every filter and spline: mirrored about the border pixels. Twin: mirror in src/stages/field.rs.
//
// Without integer division, which software devices do one lane at a time: with it, all passes of the heat sink took three
// times as long on lavapipe.

// For any i, once or several times reflected.
int mirror(int i, int size) {
    float period = 2.0 * float(max(size - 1, 1));
    float a = abs(float(i));
    int j = int(a - period * floor(a / period));
    return min(min(j, int(period) - j), size - 1);
}

// For an i that is less than size outside: one reflection.
ivec2 reflect_once(ivec2 i, ivec2 size) {
    ivec2 last = size - 1;
    return last - abs(last - abs(i));
}
