/* Pictures whose relative blur and registration are known, for the examples; yours come of a camera. */
#ifndef PAIR_H
#define PAIR_H

#include <math.h>

enum { PAIR_SIZE = 96, PAIR_PIXELS = PAIR_SIZE * PAIR_SIZE };

/* Waves in all directions, seen through a Gaussian of so many px² of variance, and moved by dx, dy px. */
static void pair_photograph(double variance, double dx, double dy, float *values) {
  for (int i = 0; i < PAIR_PIXELS; i++) {
    double x = i % PAIR_SIZE - dx, y = i / PAIR_SIZE - dy, sum = 0;
    for (int wave = 0; wave < 64; wave++) {
      double n = 2.4 * wave, radius = 0.2 + 0.006 * n, u = radius * cos(n), v = radius * sin(n);
      sum += exp(-variance * (u * u + v * v) / 2) * cos(u * x + v * y + n * n);
    }
    values[i] = (float)(0.5 + 0.04 * sum);
  }
}

#endif
