// The border rule of every filter and spline: mirrored about the border pixels.

int mirror(int i, int size) {
    int last = max(size - 1, 1);
    i = abs(i) % (2 * last);
    return min(min(i, 2 * last - i), size - 1);
}
