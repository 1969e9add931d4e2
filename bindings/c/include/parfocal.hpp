/* parfocal.h for C++17: classes free their handles, errors throw, sizes of structs are set. */
#ifndef PARFOCAL_HPP
#define PARFOCAL_HPP

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "parfocal.h"

namespace parfocal {

/// The error of a call. what() says what to do.
class Error : public std::runtime_error {
 public:
  Error(parfocal_status status, const char *message) : std::runtime_error(message), status_(status) {}
  parfocal_status status() const noexcept { return status_; }

 private:
  parfocal_status status_;
};

namespace detail {

inline void check(parfocal_status status) {
  if (status != PARFOCAL_OK) throw Error(status, parfocal_last_error());
}

struct Free {
  void operator()(parfocal_engine *handle) const noexcept { parfocal_engine_free(handle); }
  void operator()(parfocal_solver *handle) const noexcept { parfocal_solver_free(handle); }
  void operator()(parfocal_solution *handle) const noexcept { parfocal_solution_free(handle); }
  void operator()(parfocal_stream *handle) const noexcept { parfocal_stream_free(handle); }
  void operator()(parfocal_sweep *handle) const noexcept { parfocal_sweep_free(handle); }
  void operator()(parfocal_cancellation_token *handle) const noexcept { parfocal_cancellation_token_free(handle); }
};

template <class T>
using Handle = std::unique_ptr<T, Free>;

template <class T>
constexpr std::uint32_t depth_of() {
  static_assert(std::is_same_v<T, std::uint8_t> || std::is_same_v<T, std::uint16_t> || std::is_same_v<T, float>,
                "samples are uint8_t, uint16_t or float");
  return std::is_same_v<T, std::uint8_t> ? PARFOCAL_U8 : std::is_same_v<T, std::uint16_t> ? PARFOCAL_U16 : PARFOCAL_F32;
}

}  // namespace detail

/// A photograph in the caller's memory: rows of pixels with one sample, or with three (red, green, blue).
struct Image : parfocal_image {
  template <class T>
  Image(const T *samples, std::uint32_t columns, std::uint32_t rows, std::uint32_t channel_count = 1,
        std::size_t bytes_a_row = 0)
      : parfocal_image{sizeof(parfocal_image), samples,     columns, rows, channel_count,
                       detail::depth_of<T>(),  bytes_a_row, nullptr} {}
  /// A camera frame. format_name is the GenICam name, for example "Mono12p"; the pointer must stay valid. channels and depth
  /// describe the unpacked image.
  static Image packed(const void *bytes, const char *format_name, std::uint32_t columns, std::uint32_t rows,
                      std::size_t bytes_a_row = 0) {
    Image image(static_cast<const std::uint8_t *>(bytes), columns, rows, 1, bytes_a_row);
    image.format = format_name;
    const std::string name(format_name);
    const auto digits = name.find_first_of("0123456789");
    const int bits = digits == std::string::npos ? 8 : std::atoi(name.c_str() + digits);
    image.channels = name.compare(0, 4, "Mono") == 0 ? 1 : 3;
    image.depth = bits == 8 ? PARFOCAL_U8 : bits == 32 ? PARFOCAL_F32 : PARFOCAL_U16;
    return image;
  }
};

/// Cancels solves, from any thread. Set it in their SolveOptions.
class CancellationToken {
 public:
  CancellationToken() {
    parfocal_cancellation_token *made = nullptr;
    detail::check(parfocal_cancellation_token_new(&made));
    handle_.reset(made);
  }
  void cancel() const { detail::check(parfocal_cancellation_token_cancel(handle_.get())); }
  const parfocal_cancellation_token *get() const noexcept { return handle_.get(); }

 private:
  detail::Handle<parfocal_cancellation_token> handle_;
};

/// The settings, with their defaults.
struct Settings : parfocal_settings {
  Settings() : parfocal_settings() {
    size = sizeof(parfocal_settings);
    detail::check(parfocal_settings_init(this));
  }
};

/// The options of one solve: region, mask, progress and cancellation. By default the whole image.
struct SolveOptions : parfocal_solve_options {
  SolveOptions() : parfocal_solve_options() { size = sizeof(parfocal_solve_options); }
};

/// A lens. Its blur is a disk unless kappa is set.
struct Lens : parfocal_lens {
  Lens(double focal_length_mm, double f_number_, double pixel_pitch_mm, double focus_1_mm, double focus_2_mm,
       bool telecentric_ = false)
      : parfocal_lens{sizeof(parfocal_lens), focal_length_mm,          f_number_, pixel_pitch_mm,
                      {focus_1_mm, focus_2_mm}, 0,                     telecentric_} {}
};

/// Depth from the lens and its standard deviation, mm; NaN where there is none.
struct Depth {
  std::vector<float> depth, deviation;
};

class Solution;
class Sweep;

/// A device. One engine per process is enough.
class Engine {
 public:
  explicit Engine(const char *device = nullptr, bool validation = false, double timeout_s = 0) {
    parfocal_engine_options options{};
    options.size = sizeof options;
    options.device = device;
    options.timeout_s = timeout_s;
    options.validation = validation;
    parfocal_engine *made = nullptr;
    detail::check(parfocal_engine_new(&options, &made));
    handle_.reset(made);
  }
  /// An engine on a Vulkan device of the embedding program, which keeps owning it.
  explicit Engine(const parfocal_vulkan &vulkan, double timeout_s = 0) {
    parfocal_engine_options options{};
    options.size = sizeof options;
    options.timeout_s = timeout_s;
    parfocal_engine *made = nullptr;
    detail::check(parfocal_engine_from_vulkan(&vulkan, &options, &made));
    handle_.reset(made);
  }
  std::string device() const { return parfocal_engine_device(handle_.get()); }
  /// The validation messages so far, one per line.
  std::string messages() const { return parfocal_engine_messages(handle_.get()); }
  const parfocal_engine *get() const noexcept { return handle_.get(); }

  /// Solves a focus sweep. positions has one value per frame, or is empty.
  inline Sweep solve_sweep(const std::vector<Image> &frames, const std::vector<double> &positions = {},
                     parfocal_position_unit unit = PARFOCAL_UNIT_STEPS, int reference = -1,
                     const Settings &settings = Settings(), const SolveOptions &scope = SolveOptions()) const;

 private:
  detail::Handle<parfocal_engine> handle_;
};

/// The result of a pair. `*` and `->` access its numbers and fields, which live as long as the object.
class Solution {
 public:
  explicit Solution(parfocal_solution *handle) : handle_(handle), view_() {
    view_.size = sizeof view_;
    detail::check(parfocal_solution_get(handle_.get(), &view_));
  }
  const parfocal_solution_view &operator*() const noexcept { return view_; }
  const parfocal_solution_view *operator->() const noexcept { return &view_; }

  std::vector<std::string> warnings() const {
    std::vector<std::string> all;
    for (std::uint32_t i = 0; i < view_.warnings; i++) all.emplace_back(parfocal_solution_warning(handle_.get(), i));
    return all;
  }
  Depth depth(const parfocal_lens &lens) const {
    const std::size_t count = std::size_t{view_.width} * view_.height;
    Depth result{std::vector<float>(count), std::vector<float>(count)};
    detail::check(parfocal_solution_depth(handle_.get(), &lens, result.depth.data(), result.deviation.data(), count));
    return result;
  }
  /// Resamples another photograph, taken like I2, onto the pixels of the results. T is its sample type.
  template <class T>
  std::vector<T> apply(const Image &image, bool exposure = false) const {
    if (image.depth != detail::depth_of<T>()) throw Error(PARFOCAL_ERROR_INVALID_ARGUMENT, "apply<T>: the samples of the image have another type than T");
    std::vector<T> out(std::size_t{view_.width} * view_.height * image.channels);
    detail::check(parfocal_solution_apply(handle_.get(), &image, exposure, out.data(), out.size() * sizeof(T)));
    return out;
  }

 private:
  detail::Handle<parfocal_solution> handle_;
  parfocal_solution_view view_;
};

/// A solver of pairs with its settings.
class Solver {
 public:
  explicit Solver(const Engine &engine, const Settings &settings = Settings()) {
    parfocal_solver *made = nullptr;
    detail::check(parfocal_solver_new(engine.get(), &settings, &made));
    handle_.reset(made);
  }
  Solution solve(const Image &i1, const Image &i2, const SolveOptions &scope = SolveOptions()) {
    parfocal_solution *made = nullptr;
    detail::check(parfocal_solver_solve(handle_.get(), &i1, &i2, &scope, &made));
    return Solution(made);
  }
  /// Registers a pair. The solution has no fields.
  Solution register_pair(const Image &i1, const Image &i2) {
    parfocal_solution *made = nullptr;
    detail::check(parfocal_solver_register(handle_.get(), &i1, &i2, &made));
    return Solution(made);
  }

 private:
  detail::Handle<parfocal_solver> handle_;
};

/// Solves many pairs of the same size and format, in order. One thread may push while another reads.
class Stream {
 public:
  /// No time limit, for use when another thread pushes or reads.
  static constexpr double forever = std::numeric_limits<double>::infinity();

  /// i1 and i2 state the size and format of all pairs; their pixels are not read. Three slots keep a device busy.
  Stream(const std::vector<const Engine *> &engines, const Image &i1, const Image &i2, const Settings &settings = Settings(),
         std::uint32_t slots = 3) {
    std::vector<const parfocal_engine *> handles;
    for (const auto *engine : engines) handles.push_back(engine->get());
    parfocal_stream *made = nullptr;
    const parfocal_engine *none = nullptr;
    detail::check(parfocal_stream_new(handles.empty() ? &none : handles.data(), handles.size(), slots, &i1, &i2, &settings, &made));
    handle_.reset(made);
  }
  Stream(const Engine &engine, const Image &i1, const Image &i2, const Settings &settings = Settings(), std::uint32_t slots = 3)
      : Stream(std::vector<const Engine *>{&engine}, i1, i2, settings, slots) {}

  /// Copies a pair into the stream. Returns false if there is no room within `seconds`: read a solution first.
  bool push(const Image &i1, const Image &i2, double seconds = 0) {
    const auto status = parfocal_stream_push(handle_.get(), &i1, &i2, seconds);
    if (status != PARFOCAL_ERROR_FULL) detail::check(status);
    return status == PARFOCAL_OK;
  }
  /// Reads the solution of the oldest unread pair; nullopt if it is not ready within `seconds`, and after finish() once all
  /// have been read. Throws that pair's error. Later pairs are unaffected.
  std::optional<Solution> next(double seconds = forever) {
    parfocal_solution *made = nullptr;
    detail::check(parfocal_stream_next(handle_.get(), seconds, &made));
    return made ? std::optional<Solution>(std::in_place, made) : std::nullopt;
  }
  /// Marks the end of input. A later push reopens the stream.
  void finish() { detail::check(parfocal_stream_finish(handle_.get())); }
  /// The number of pairs that may be pushed and not yet read.
  std::size_t capacity() const noexcept { return parfocal_stream_capacity(handle_.get()); }
  /// The number of pairs pushed and not yet read.
  std::size_t size() const noexcept { return parfocal_stream_length(handle_.get()); }

 private:
  detail::Handle<parfocal_stream> handle_;
};

/// The result of a focus sweep. `*` and `->` access its numbers and fields, which live as long as the object.
class Sweep {
 public:
  explicit Sweep(parfocal_sweep *handle) : handle_(handle), view_() {
    view_.size = sizeof view_;
    detail::check(parfocal_sweep_get(handle_.get(), &view_));
  }
  const parfocal_sweep_view &operator*() const noexcept { return view_; }
  const parfocal_sweep_view *operator->() const noexcept { return &view_; }

  std::vector<std::string> warnings() const {
    std::vector<std::string> all;
    for (std::uint32_t i = 0; i < view_.warnings; i++) all.emplace_back(parfocal_sweep_warning(handle_.get(), i));
    return all;
  }
  /// T of a frame, counted from 0, row by row.
  std::array<double, 9> transform(std::uint32_t frame) const {
    std::array<double, 9> rows{};
    detail::check(parfocal_sweep_transform(handle_.get(), frame, rows.data()));
    return rows;
  }
  /// Parallax of a frame, counted from 0, to the right and downwards, px per setting.
  std::array<double, 2> parallax(std::uint32_t frame) const {
    std::array<double, 2> moves{};
    detail::check(parfocal_sweep_parallax(handle_.get(), frame, moves.data()));
    return moves;
  }
  /// Resamples another photograph, taken like one frame (counted from 0), onto the pixels of the results.
  template <class T>
  std::vector<T> apply(std::uint32_t frame, const Image &image, bool exposure = false) const {
    if (image.depth != detail::depth_of<T>()) throw Error(PARFOCAL_ERROR_INVALID_ARGUMENT, "apply<T>: the samples of the image have another type than T");
    std::vector<T> out(std::size_t{view_.width} * view_.height * image.channels);
    detail::check(parfocal_sweep_apply(handle_.get(), frame, &image, exposure, out.data(), out.size() * sizeof(T)));
    return out;
  }

 private:
  detail::Handle<parfocal_sweep> handle_;
  parfocal_sweep_view view_;
};

inline Sweep Engine::solve_sweep(const std::vector<Image> &frames, const std::vector<double> &positions,
                           parfocal_position_unit unit, int reference, const Settings &settings, const SolveOptions &scope) const {
  if (!positions.empty() && positions.size() != frames.size())
    throw Error(PARFOCAL_ERROR_MISMATCH, "give one position per frame, or none");
  const std::vector<parfocal_image> images(frames.begin(), frames.end());
  parfocal_sweep_options options{};
  options.size = sizeof options;
  options.positions = positions.empty() ? nullptr : positions.data();
  options.unit = unit;
  options.reference = reference;
  parfocal_sweep *made = nullptr;
  detail::check(parfocal_sweep_solve(get(), images.data(), images.size(), &settings, &options, &scope, &made));
  return Sweep(made);
}

/// Measures the step from region `from` to region `to`, in the unit of the field; NaN if too few pixels are valid.
inline parfocal_estimate step(const float *values, std::uint32_t width, std::uint32_t height, parfocal_region from,
                              parfocal_region to) {
  parfocal_estimate estimate{};
  detail::check(parfocal_measure_step(values, width, height, from, to, &estimate));
  return estimate;
}

/// Samples a field along a line. Each value is the mean over `across` px across the line.
inline std::vector<double> profile(const float *values, std::uint32_t width, std::uint32_t height, double x1, double y1,
                                   double x2, double y2, double across = 1) {
  std::vector<double> along(parfocal_profile_length(x1, y1, x2, y2));
  // At least one value, so that the call reports what is wrong with the line.
  if (along.empty()) along.resize(1);
  detail::check(parfocal_measure_profile(values, width, height, x1, y1, x2, y2, across, along.data(), along.size()));
  return along;
}

/// The evaluation of a surface, with its defaults.
struct RoughnessOptions : parfocal_roughness_options {
  RoughnessOptions() : parfocal_roughness_options() {
    size = sizeof(parfocal_roughness_options);
    detail::check(parfocal_roughness_options_init(this));
  }
};

/// Evaluates the texture of heights, positive towards the camera, with their standard deviations.
inline parfocal_roughness roughness(const float *heights, const float *deviation, std::uint32_t width,
                                    std::uint32_t height, const RoughnessOptions &options = {}) {
  parfocal_roughness found{};
  found.size = sizeof found;
  detail::check(parfocal_measure_roughness(heights, deviation, width, height, &options, &found));
  return found;
}

/// Compares repeated height maps of one unmoved part, each with its standard deviations.
inline parfocal_repeatability repeatability(const std::vector<const float *> &heights,
                                            const std::vector<const float *> &deviations, std::uint32_t width,
                                            std::uint32_t height, parfocal_form form = PARFOCAL_FORM_NONE) {
  if (heights.size() != deviations.size())
    throw Error(PARFOCAL_ERROR_MISMATCH, "give the standard deviations of each height map");
  parfocal_repeatability found{};
  found.size = sizeof found;
  detail::check(parfocal_measure_repeatability(heights.data(), deviations.data(), heights.size(), width, height,
                                               nullptr, nullptr, form, &found));
  return found;
}

}  // namespace parfocal

#endif
