// The border rule of splines: mirrored about the border pixels. Twin: mirror in src/engine/stages/field.rs.

// For an i that is less than size outside: one reflection.
ivec2 reflect_once(ivec2 i, ivec2 size) {
    ivec2 last = size - 1;
    return last - abs(last - abs(i));
}
