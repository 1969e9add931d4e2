/* Solves a pair in memory and prints relative blur and registration. */
#include <parfocal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pair.h"

/* Prints the error of a failed call and jumps to the cleanup. Freeing NULL does nothing. */
#define TRY(call)                                                  \
  do {                                                             \
    if ((call) != PARFOCAL_OK) {                                   \
      fprintf(stderr, "%s: %s\n", #call, parfocal_last_error());   \
      goto done;                                                   \
    }                                                              \
  } while (0)

static float samples[2][PAIR_PIXELS];

/* A result other than 0 cancels the solve; so does parfocal_cancellation_token_cancel from another thread. */
static int32_t progress(void *context, double done) {
  *(double *)context = done;
  return 0;
}

static parfocal_image image(const float *data) {
  parfocal_image image = {.size = sizeof image, .width = PAIR_SIZE, .height = PAIR_SIZE, .channels = 1, .depth = PARFOCAL_F32};
  image.data = data;
  return image;
}

int main(void) {
  int failed = 1;
  const char *validate = getenv("PARFOCAL_VALIDATE");
  parfocal_engine *engine = NULL;
  parfocal_solver *solver = NULL;
  parfocal_solution *solution = NULL;
  parfocal_engine_options options = {sizeof options, NULL, 0, validate && !strcmp(validate, "1")};
  parfocal_settings settings = {.size = sizeof settings};
  parfocal_solution_view view = {.size = sizeof view};
  parfocal_image i1 = image(samples[0]), i2 = image(samples[1]);
  double done = 0;
  parfocal_solve_options solve = {.size = sizeof solve, .progress = progress, .context = &done};

  /* I2 has 1 px² more blur variance, and is shifted by 0.8 px right and 0.6 px up. */
  pair_photograph(0.5, 0, 0, samples[0]);
  pair_photograph(1.5, 0.8, -0.6, samples[1]);

  TRY(parfocal_engine_new(&options, &engine));
  TRY(parfocal_settings_init(&settings));
  settings.max_relative_blur = 36;
  TRY(parfocal_solver_new(engine, &settings, &solver));
  TRY(parfocal_solver_solve(solver, &i1, &i2, &solve, &solution));
  TRY(parfocal_solution_get(solution, &view));

  printf("%s, %.0f %% done: V in the middle %.3f px², T %.3f %.3f px, %s\n", parfocal_engine_device(engine), 100 * done,
         view.relative_blur[view.width * (view.height / 2) + view.width / 2], view.transform[2], view.transform[5],
         view.converged ? "converged" : "not converged");
  for (unsigned i = 0; i < view.warnings; i++)
    printf("warning: %s\n", parfocal_solution_warning(solution, i));
  fputs(parfocal_engine_messages(engine), stderr);
  failed = *parfocal_engine_messages(engine) != '\0';

done:
  /* In any order. */
  parfocal_engine_free(engine);
  parfocal_solver_free(solver);
#ifndef FORGET_THE_SOLUTION /* defined by the test of the leak check */
  parfocal_solution_free(solution);
#endif
  return failed;
}
