// The candidates for the law, and what windows store of them. CPU reference: src/engine/stages/lens_windows.rs.

const int MOST_LENSES = 14;
// The numbers of a window, logarithms of ratios of residuals: a Gaussian's over a disk's, by the relative law; then of
// each lens CHAIN: the next lens's over this one's, KERNEL: a Gaussian's over a disk's, LAW: the relative law's over
// this one's; then the mean of |V|, px² of the full-size image, or -1 if the window does not count.
const int CHAIN = 0, KERNEL = 1, LAW = 2, OF_LENS = 3;
const int MEAN = 1 + OF_LENS * MOST_LENSES, NUMBERS = MEAN + 1;
// Separations of the first search, px² of the full-size image, and later ones about the one that was found.
const float FIRST_SEPARATION = 0.6, FIRST_RATIO = 1.5, RATIO = 1.35;
const int LATER_LENSES = 5;

int lenses(float found) { return found > 0.0 ? LATER_LENSES : MOST_LENSES; }

float separation_of(int lens, float found) {
    return found > 0.0 ? found * pow(RATIO, float(lens - LATER_LENSES / 2)) : FIRST_SEPARATION * pow(FIRST_RATIO, float(lens));
}
