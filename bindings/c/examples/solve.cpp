// Solves and registers a pair, and solves a stream of pairs and a focus sweep, from C++.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <parfocal.hpp>
#include <string>
#include <vector>

#include "pair.h"

static std::vector<float> photograph(double variance, double dx, double dy) {
  std::vector<float> values(PAIR_PIXELS);
  pair_photograph(variance, dx, dy, values.data());
  return values;
}

int main() try {
  const char *validate = std::getenv("PARFOCAL_VALIDATE");
  const parfocal::Engine engine(nullptr, validate && std::string(validate) == "1");
  const auto image = [](const std::vector<float> &values) { return parfocal::Image(values.data(), PAIR_SIZE, PAIR_SIZE); };

  const auto near = photograph(0.5, 0, 0), far = photograph(1.5, 0.8, -0.6);
  parfocal::Settings settings;
  settings.max_relative_blur = 36;
  parfocal::Solver solver(engine, settings);

  const auto solution = solver.solve(image(near), image(far));
  const auto middle = solution->width * (solution->height / 2) + solution->width / 2;
  std::cout << engine.device() << ": V in the middle " << solution->relative_blur[middle] << " px²\n";
  for (const auto &warning : solution.warnings()) std::cout << "warning: " << warning << '\n';

  const parfocal::Lens lens(50, 4, 0.0075, 300, 310, true);
  const auto depth = solution.depth(lens).depth;
  std::cout << "depth in the middle " << depth[middle] << " mm\n";
  const auto step = parfocal::step(depth.data(), PAIR_SIZE, PAIR_SIZE, {20, 30, 20, 30}, {56, 30, 20, 30});
  std::cout << "the right is farther by " << step.value << " +- " << step.standard_error << " mm, along a line of "
            << parfocal::profile(depth.data(), PAIR_SIZE, PAIR_SIZE, 20, 48, 76, 48, 5).size() << " values\n";

  parfocal::SolveOptions options;
  options.region = {32, 40, 24, 16};
  const auto part = solver.solve(image(near), image(far), options);
  std::cout << "a part of " << part->width << 'x' << part->height << " px from " << part->origin[0] << ", " << part->origin[1] << '\n';

  // A cancelled solve ends soon, and the solver stays usable.
  const parfocal::CancellationToken cancel;
  parfocal::SolveOptions cancelled;
  cancelled.cancel = cancel.get();
  cancelled.context = const_cast<parfocal::CancellationToken *>(&cancel);
  cancelled.progress = [](void *context, double) {
    static_cast<const parfocal::CancellationToken *>(context)->cancel();
    return std::int32_t{0};
  };
  try {
    solver.solve(image(near), image(far), cancelled);
  } catch (const parfocal::Error &error) {
    std::cout << error.what() << (error.status() == PARFOCAL_ERROR_CANCELLED ? "\n" : ", which this program did not expect\n");
  }

  // Camera frames, here with two pixels in three bytes.
  std::vector<std::uint8_t> packed[2];
  const auto sample = [](float value) { return static_cast<unsigned>((0.5 + 0.4 * (value - 0.5)) * 4095 + 0.5); };
  for (int n = 0; n < 2; n++) {
    const auto &values = n ? far : near;
    for (std::size_t i = 0; i + 1 < values.size(); i += 2) {
      const auto a = sample(values[i]), b = sample(values[i + 1]);
      for (const auto byte : {a & 255, a >> 8 | (b & 15) << 4, b >> 4}) packed[n].push_back(static_cast<std::uint8_t>(byte));
    }
  }
  const auto from_camera = solver.solve(parfocal::Image::packed(packed[0].data(), "Mono12p", PAIR_SIZE, PAIR_SIZE),
                                      parfocal::Image::packed(packed[1].data(), "Mono12p", PAIR_SIZE, PAIR_SIZE));
  std::cout << "from 12 bits, V in the middle " << from_camera->relative_blur[middle] << " px²\n";

  const auto registered = solver.register_pair(image(near), image(far));
  std::cout << "T " << registered->transform[2] << ' ' << registered->transform[5] << " px\n";
  const auto moved = registered.apply<float>(image(far));
  std::cout << "I2 on I1 in the middle " << moved[middle] << ", I1 " << near[middle] << '\n';

  // The next pair is uploaded while the device solves. If there is no room for it, read a solution first.
  parfocal::Stream stream(engine, image(near), image(far), settings);
  int same = 0;
  const auto use = [&](const parfocal::Solution &next) { same += next->relative_blur[middle] == solution->relative_blur[middle]; };
  for (int n = 0; n < 9; n++)
    while (!stream.push(image(near), image(far))) use(*stream.next());
  stream.finish();
  while (const auto next = stream.next()) use(*next);
  std::cout << same << " of 9 pairs of a stream give the same result\n";

  // Five frames; the scene is in focus in the third.
  std::vector<std::vector<float>> sweep;
  for (int n = -2; n <= 2; n++) sweep.push_back(photograph(0.3 + n * n, 0.1 * n, 0));
  std::vector<parfocal::Image> frames;
  for (const auto &frame : sweep) frames.push_back(image(frame));
  const auto stacked = engine.solve_sweep(frames);
  std::cout << "the middle is in focus at " << stacked->focus[middle] << " of frames 0 to 4\n";
  std::cout << "the last frame is shifted by " << stacked.transform(4)[2] << " px to the right; resampled, its middle is "
            << stacked.apply<float>(4, frames[4])[middle] << '\n';

  // The texture of V, whose scale is uncertain too, and the noise of two solves of the same part.
  std::vector<float> common;
  for (std::size_t i = 0; i < near.size(); i++)
    common.push_back(static_cast<float>(solution->scale_deviation) * solution->relative_blur[i]);
  parfocal::RoughnessOptions evaluation;
  evaluation.common = common.data();
  evaluation.l_filter_px = 40;
  const auto width = solution->width, height = solution->height;
  const auto texture = parfocal::roughness(solution->relative_blur, solution->uncertainty, width, height, evaluation);
  std::cout << "Sq " << texture.sq.value << " ± " << texture.sq.standard_deviation << " px²\n";
  // Both have the error of the scale in common: repetition does not show it.
  const auto without_scale = [&](const parfocal::Solution &of) {
    std::vector<float> deviation;
    for (std::size_t i = 0; i < near.size(); i++) {
      const double scale = of->scale_deviation * of->relative_blur[i], all = of->uncertainty[i];
      deviation.push_back(static_cast<float>(std::sqrt(std::max(0.0, all * all - scale * scale))));
    }
    return deviation;
  };
  const auto first = without_scale(solution), second = without_scale(from_camera);
  const auto repeated = parfocal::repeatability({solution->relative_blur, from_camera->relative_blur},
                                                {first.data(), second.data()}, width, height);
  std::cout << "the noise of a map is " << repeated.noise.value << " px²\n";

  std::cerr << engine.messages();
  return engine.messages().empty() ? EXIT_SUCCESS : EXIT_FAILURE;
} catch (const parfocal::Error &error) {
  std::cerr << error.what() << '\n';
  return EXIT_FAILURE;
}
