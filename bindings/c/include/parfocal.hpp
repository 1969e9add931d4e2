/* Depth from defocus on the GPU: parfocal.h for C++17. Handles free themselves, what fails throws, sizes fill themselves in. */
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

/// What a call failed by; what() says what to do.
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
  void operator()(parfocal_cancel *handle) const noexcept { parfocal_cancel_free(handle); }
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

/// A photograph in memory of the caller's: rows of one sample a pixel, or of three, red, green, blue.
struct Image : parfocal_image {
  template <class T>
  Image(const T *samples, std::uint32_t columns, std::uint32_t rows, std::uint32_t channel_count = 1,
        std::size_t bytes_a_row = 0)
      : parfocal_image{sizeof(parfocal_image), samples,     columns, rows, channel_count,
                       detail::depth_of<T>(),  bytes_a_row, nullptr} {}
  /// As a camera packs it, by GenICam's name of the format, such as "Mono12p", which is kept by pointer; channels and depth are what it is unpacked to.
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

/// Calls solves off, from any thread: give it to their Scope.
class Cancel {
 public:
  Cancel() {
    parfocal_cancel *made = nullptr;
    detail::check(parfocal_cancel_new(&made));
    handle_.reset(made);
  }
  void now() const { detail::check(parfocal_cancel_now(handle_.get())); }
  const parfocal_cancel *get() const noexcept { return handle_.get(); }

 private:
  detail::Handle<parfocal_cancel> handle_;
};

/// The settings, with their defaults.
struct Settings : parfocal_settings {
  Settings() : parfocal_settings() {
    size = sizeof(parfocal_settings);
    detail::check(parfocal_settings_init(this));
  }
};

/// What of a pair or a sweep is solved, all of it by default; who is told, and what calls it off.
struct Scope : parfocal_scope {
  Scope() : parfocal_scope() { size = sizeof(parfocal_scope); }
};

/// A lens in front of the sensor: a disk unless kappa says otherwise.
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

/// A device; one a process is enough.
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
  /// On a Vulkan device of the program's, which keeps it.
  explicit Engine(const parfocal_vulkan &vulkan, double timeout_s = 0) {
    parfocal_engine_options options{};
    options.size = sizeof options;
    options.timeout_s = timeout_s;
    parfocal_engine *made = nullptr;
    detail::check(parfocal_engine_from_vulkan(&vulkan, &options, &made));
    handle_.reset(made);
  }
  std::string device() const { return parfocal_engine_device(handle_.get()); }
  /// What validation has said so far.
  std::string messages() const { return parfocal_engine_messages(handle_.get()); }
  const parfocal_engine *get() const noexcept { return handle_.get(); }

  /// Solves a focus sweep; positions, one a frame, may be empty.
  inline Sweep stack(const std::vector<Image> &frames, const std::vector<double> &positions = {},
                     parfocal_positions unit = PARFOCAL_SETTINGS, int reference = -1,
                     const Settings &settings = Settings(), const Scope &scope = Scope()) const;

 private:
  detail::Handle<parfocal_engine> handle_;
};

/// What was found of a pair; `*` and `->` are to its numbers and fields, which live as long as it does.
class Solution {
 public:
  explicit Solution(parfocal_solution *handle) : handle_(handle), found_() {
    found_.size = sizeof found_;
    detail::check(parfocal_solution_get(handle_.get(), &found_));
  }
  const parfocal_found &operator*() const noexcept { return found_; }
  const parfocal_found *operator->() const noexcept { return &found_; }

  std::vector<std::string> warnings() const {
    std::vector<std::string> all;
    for (std::uint32_t i = 0; i < found_.warnings; i++) all.emplace_back(parfocal_solution_warning(handle_.get(), i));
    return all;
  }
  Depth depth(const parfocal_lens &lens) const {
    const std::size_t count = std::size_t{found_.width} * found_.height;
    Depth found{std::vector<float>(count), std::vector<float>(count)};
    detail::check(parfocal_solution_depth(handle_.get(), &lens, found.depth.data(), found.deviation.data(), count));
    return found;
  }
  /// Another photograph of I2's camera on the pixels of the results; T is what its samples are.
  template <class T>
  std::vector<T> apply(const Image &image, bool exposure = false) const {
    if (image.depth != detail::depth_of<T>()) throw Error(PARFOCAL_INVALID_ARGUMENT, "apply<T>: the image's samples are no T");
    std::vector<T> out(std::size_t{found_.width} * found_.height * image.channels);
    detail::check(parfocal_solution_apply(handle_.get(), &image, exposure, out.data(), out.size() * sizeof(T)));
    return out;
  }

 private:
  detail::Handle<parfocal_solution> handle_;
  parfocal_found found_;
};

/// Settings, and what is kept from pair to pair.
class Solver {
 public:
  explicit Solver(const Engine &engine, const Settings &settings = Settings()) {
    parfocal_solver *made = nullptr;
    detail::check(parfocal_solver_new(engine.get(), &settings, &made));
    handle_.reset(made);
  }
  Solution solve(const Image &i1, const Image &i2, const Scope &scope = Scope()) {
    parfocal_solution *made = nullptr;
    detail::check(parfocal_solver_solve(handle_.get(), &i1, &i2, &scope, &made));
    return Solution(made);
  }
  /// T and brightness alone: a solution without fields.
  Solution register_pair(const Image &i1, const Image &i2) {
    parfocal_solution *made = nullptr;
    detail::check(parfocal_solver_register(handle_.get(), &i1, &i2, &made));
    return Solution(made);
  }

 private:
  detail::Handle<parfocal_solver> handle_;
};

/// Many pairs of one size and kind in, their solutions out in the same order. One thread may push while another reads.
class Stream {
 public:
  /// Waits for ever, where another thread pushes or reads.
  static constexpr double forever = std::numeric_limits<double>::infinity();

  /// For pairs like these two, of which no pixel is read; three slots keep a device busy.
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

  /// Copies a pair and hands it over; false where there is no room for it within so many seconds: read a solution first.
  bool push(const Image &i1, const Image &i2, double seconds = 0) {
    const auto status = parfocal_stream_push(handle_.get(), &i1, &i2, seconds);
    if (status != PARFOCAL_FULL) detail::check(status);
    return status == PARFOCAL_OK;
  }
  /// The solution of the oldest pair that has not been read; none where it is not there within so many seconds, and after finish() where
  /// all have been read. Throws what that pair failed of; those behind it go on.
  std::optional<Solution> next(double seconds = forever) {
    parfocal_solution *made = nullptr;
    detail::check(parfocal_stream_next(handle_.get(), seconds, &made));
    return made ? std::optional<Solution>(std::in_place, made) : std::nullopt;
  }
  /// Says that no more pairs come; another push takes it back.
  void finish() { detail::check(parfocal_stream_finish(handle_.get())); }
  /// How many pairs may be pushed and not yet read: only reading makes room.
  std::size_t capacity() const noexcept { return parfocal_stream_capacity(handle_.get()); }
  /// How many were pushed and not yet read.
  std::size_t size() const noexcept { return parfocal_stream_length(handle_.get()); }

 private:
  detail::Handle<parfocal_stream> handle_;
};

/// What was found of a focus sweep; `*` and `->` are to its numbers and fields, which live as long as it does.
class Sweep {
 public:
  explicit Sweep(parfocal_sweep *handle) : handle_(handle), found_() {
    found_.size = sizeof found_;
    detail::check(parfocal_sweep_get(handle_.get(), &found_));
  }
  const parfocal_sweep_found &operator*() const noexcept { return found_; }
  const parfocal_sweep_found *operator->() const noexcept { return &found_; }

  std::vector<std::string> warnings() const {
    std::vector<std::string> all;
    for (std::uint32_t i = 0; i < found_.warnings; i++) all.emplace_back(parfocal_sweep_warning(handle_.get(), i));
    return all;
  }
  /// T of a frame, counted from 0, by rows.
  std::array<double, 9> transform(std::uint32_t frame) const {
    std::array<double, 9> rows{};
    detail::check(parfocal_sweep_transform(handle_.get(), frame, rows.data()));
    return rows;
  }
  /// Another photograph of a frame, counted from 0, on the pixels of the results.
  template <class T>
  std::vector<T> apply(std::uint32_t frame, const Image &image, bool exposure = false) const {
    if (image.depth != detail::depth_of<T>()) throw Error(PARFOCAL_INVALID_ARGUMENT, "apply<T>: the image's samples are no T");
    std::vector<T> out(std::size_t{found_.width} * found_.height * image.channels);
    detail::check(parfocal_sweep_apply(handle_.get(), frame, &image, exposure, out.data(), out.size() * sizeof(T)));
    return out;
  }

 private:
  detail::Handle<parfocal_sweep> handle_;
  parfocal_sweep_found found_;
};

inline Sweep Engine::stack(const std::vector<Image> &frames, const std::vector<double> &positions,
                           parfocal_positions unit, int reference, const Settings &settings, const Scope &scope) const {
  if (!positions.empty() && positions.size() != frames.size())
    throw Error(PARFOCAL_MISMATCH, "a sweep has one position for each frame, or none");
  const std::vector<parfocal_image> images(frames.begin(), frames.end());
  parfocal_sweep_options options{};
  options.size = sizeof options;
  options.positions = positions.empty() ? nullptr : positions.data();
  options.unit = unit;
  options.reference = reference;
  parfocal_sweep *made = nullptr;
  detail::check(parfocal_stack(get(), images.data(), images.size(), &settings, &options, &scope, &made));
  return Sweep(made);
}

/// How far a region of a field lies above another; NaN where too few pixels are valid.
inline parfocal_estimate step(const float *values, std::uint32_t width, std::uint32_t height, parfocal_region from,
                              parfocal_region to) {
  parfocal_estimate estimate{};
  detail::check(parfocal_measure_step(values, width, height, from, to, &estimate));
  return estimate;
}

/// The values of a field along a line, each the mean over so many px across.
inline std::vector<double> profile(const float *values, std::uint32_t width, std::uint32_t height, double x1, double y1,
                                   double x2, double y2, double across = 1) {
  std::vector<double> along(parfocal_profile_length(x1, y1, x2, y2));
  // One place at least, so that the call says what is wrong with the line.
  if (along.empty()) along.resize(1);
  detail::check(parfocal_measure_profile(values, width, height, x1, y1, x2, y2, across, along.data(), along.size()));
  return along;
}

}  // namespace parfocal

#endif
