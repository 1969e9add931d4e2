// The border rule of splines: mirrored about the border pixels. CPU reference: mirror in src/engine/stages/spline.rs.

// One reflection, for an i that is outside by less than the size.
ivec2 reflect_once(ivec2 i, ivec2 size) {
    ivec2 last = size - 1;
    return last - abs(last - abs(i));
}

// The places before, at and after a place along a side, mirrored.
ivec3 beside(int place, int side) {
    return ivec3(reflect_once(ivec2(place - 1, place), ivec2(side)), reflect_once(ivec2(place + 1), ivec2(side)).x);
}
