/* Depth from defocus on the GPU: the C interface of parfocal.
 *
 * cbindgen makes this file from bindings/c/src. bindings/c/README.md describes how to build and use the library.
 *
 * Functions that can fail return a parfocal_status; parfocal_last_error() returns the message, which says what to do.
 * Structs begin with their size: set it to sizeof. Fields that a later version adds then have their defaults.
 * A handle may move between threads; one thread at a time may use it. Several threads may use an engine, a stream and a
 * cancellation token. NULL in the place of a handle is an error, never a crash; freeing NULL does nothing. Images are read
 * only during the call. */

#ifndef PARFOCAL_H
#define PARFOCAL_H

#include <stddef.h>
#include <stdint.h>

// The version of this header. parfocal_version() returns that of the library.
#define PARFOCAL_VERSION "0.1.0"
#define PARFOCAL_VERSION_MAJOR 0
#define PARFOCAL_VERSION_MINOR 1
#define PARFOCAL_VERSION_PATCH 0

// The outcome of a call.
typedef enum {
  // Success.
  PARFOCAL_OK = 0,
  // A pointer is NULL, a size field is not set, a number is not in its enumeration, or a sample is not a finite number.
  PARFOCAL_ERROR_INVALID_ARGUMENT = 1,
  // There is no Vulkan loader, no usable device, or no device of the given name.
  PARFOCAL_ERROR_NO_DEVICE = 2,
  // A Vulkan call failed.
  PARFOCAL_ERROR_VULKAN = 3,
  // The device did not finish in time. Make a new engine.
  PARFOCAL_ERROR_TIMEOUT = 4,
  // An earlier call timed out or lost the device. Make a new engine.
  PARFOCAL_ERROR_POISONED = 5,
  // The images do not fit the device.
  PARFOCAL_ERROR_TOO_LARGE = 6,
  // The images are too small to measure blur.
  PARFOCAL_ERROR_TOO_SMALL = 7,
  // Sizes or formats do not match.
  PARFOCAL_ERROR_MISMATCH = 8,
  // A setting is out of range.
  PARFOCAL_ERROR_INVALID_SETTING = 9,
  // A region or a line is not inside the image.
  PARFOCAL_ERROR_INVALID_REGION = 10,
  // An internal error: free the handles of the call, and report it.
  PARFOCAL_ERROR_INTERNAL = 11,
  // Any other error.
  PARFOCAL_ERROR_OTHER = 12,
  // The stream had no room in time, and did not take the pair. Read a result first.
  PARFOCAL_ERROR_FULL = 13,
  // The call was cancelled.
  PARFOCAL_ERROR_CANCELLED = 14,
} parfocal_status;

// The type of a sample.
typedef enum {
  // uint8_t, white at 255.
  PARFOCAL_U8 = 0,
  // uint16_t, white at 65535.
  PARFOCAL_U16 = 1,
  // float, white at 1.
  PARFOCAL_F32 = 2,
} parfocal_depth;

// The order of registration and blur estimation.
typedef enum {
  // Both jointly.
  PARFOCAL_UNIFIED = 0,
  // Relative blur only; T stays at its start.
  PARFOCAL_ALIGNED = 1,
  // Registration first, from the image difference; then relative blur.
  PARFOCAL_APPEARANCE = 2,
} parfocal_method;

// The motion model of T. Each is a special case of the next.
typedef enum {
  // Translation.
  PARFOCAL_TRANSLATION = 0,
  // Translation, rotation and scale.
  PARFOCAL_SIMILARITY = 1,
  // Similarity, stretch and shear.
  PARFOCAL_AFFINE = 2,
  // Affine and perspective.
  PARFOCAL_HOMOGRAPHY = 3,
} parfocal_motion;

// The optimiser of T.
typedef enum {
  // Gauss-Newton, with each pixel's change of V eliminated.
  PARFOCAL_GAUSS_NEWTON = 0,
  // The paper's explicit scheme, for comparison.
  PARFOCAL_GRADIENT_DESCENT = 1,
} parfocal_registration_step;

// Whether parallax is found, of a camera that moved.
typedef enum {
  // Where the photographs show it beyond doubt.
  PARFOCAL_PARALLAX_AUTO = 0,
  // Of a pair wherever it explains something.
  PARFOCAL_PARALLAX_ON = 1,
  // Never.
  PARFOCAL_PARALLAX_OFF = 2,
} parfocal_parallax_search;

// The shape of the blur kernel.
typedef enum {
  // Estimated from the photographs, between Gaussian and disk.
  PARFOCAL_KERNEL_AUTO = 0,
  // Gaussian.
  PARFOCAL_GAUSSIAN = 1,
  // Disk.
  PARFOCAL_PILLBOX = 2,
  // Half-Gaussian, the paper's asymmetric kernel.
  PARFOCAL_HALF_GAUSSIAN = 3,
} parfocal_kernel;

// How stored values become intensities.
typedef enum {
  // 8 bits of I1 or of I2 are taken for sRGB, all else for linear: as the program takes files that say nothing of it.
  PARFOCAL_DECODE_AUTO = 0,
  // As stored.
  PARFOCAL_DECODE_NONE = 1,
  // The sRGB curve is undone first.
  PARFOCAL_DECODE_SRGB = 2,
} parfocal_decode;

// The unit of focus positions.
typedef enum {
  // Steps of the focus setting, in any unit that is linear in 1/distance.
  PARFOCAL_UNIT_STEPS = 0,
  // Focus distances from the lens, mm.
  PARFOCAL_UNIT_DISTANCES = 1,
  // Positions of the plane in focus on a stage, mm from any origin.
  PARFOCAL_UNIT_STAGE = 2,
} parfocal_position_unit;

// The form that is removed from heights.
typedef enum {
  // The mean only.
  PARFOCAL_FORM_NONE = 0,
  // A plane.
  PARFOCAL_FORM_PLANE = 1,
  // A polynomial of second degree.
  PARFOCAL_FORM_QUADRIC = 2,
  // A cylinder of any direction. Not for repeated height maps.
  PARFOCAL_FORM_CYLINDER = 3,
} parfocal_form;

// Cancels solves, from any thread. Running solves with the token end soon with PARFOCAL_ERROR_CANCELLED, later ones
// at once. The other handles of a cancelled call stay usable.
typedef struct parfocal_cancellation_token parfocal_cancellation_token;

// A device. Solvers, streams and results keep it alive, so it may be freed before them.
typedef struct parfocal_engine parfocal_engine;

// The result of a solve or registration of a pair.
typedef struct parfocal_solution parfocal_solution;

// A solver of pairs. It keeps memory and recorded work for pairs of the last size and format.
typedef struct parfocal_solver parfocal_solver;

// Solves many pairs of the same size and format. Solutions come in the order of the pairs. While a device solves one pair,
// the next is uploaded and the one before is read back. One thread may push while another reads.
typedef struct parfocal_stream parfocal_stream;

// The result of a focus sweep.
typedef struct parfocal_sweep parfocal_sweep;

// The options of an engine.
typedef struct {
  // sizeof(parfocal_engine_options).
  size_t size;
  // Index, part of the name, or UUID of the device, UTF-8. NULL selects the most capable device.
  const char *device;
  // Time limit of one solve, seconds. 0 means 600.
  double timeout_s;
  // Not 0 enables validation, which needs the Khronos validation layer.
  int32_t validation;
} parfocal_engine_options;

// A Vulkan instance and device of the embedding program, both for Vulkan 1.3 or later. The device has the features
// timelineSemaphore, synchronization2 and maintenance4. Destroy them after all engines, solvers, streams and solutions.
typedef struct {
  // sizeof(parfocal_vulkan).
  size_t size;
  // The vkGetInstanceProcAddr of the loader that made the instance.
  const void *get_instance_proc_addr;
  // The VkInstance.
  const void *instance;
  // The VkPhysicalDevice.
  const void *physical_device;
  // The VkDevice.
  const void *device;
  // A VkQueue with compute support. Without lock and unlock no other code uses it.
  const void *queue;
  // The queue family index of the queue.
  uint32_t queue_family;
  // Not 0 if the device was made with VK_EXT_conditional_rendering and its feature conditionalRendering. A solve is then one
  // submission.
  int32_t conditional_rendering;
  // Locks the queue for the calling thread, which calls unlock after one submission. NULL: no other code uses the queue.
  void (*lock)(void *context);
  // Unlocks the queue.
  void (*unlock)(void *context);
  // Passed to lock and unlock, which are called from any thread.
  void *context;
} parfocal_vulkan;

// The settings of a solve. docs/method.md, section 8, describes each. parfocal_settings_init fills in the defaults.
typedef struct {
  // sizeof(parfocal_settings).
  size_t size;
  // A parfocal_method.
  uint32_t method;
  // A parfocal_motion.
  uint32_t motion;
  // A parfocal_kernel.
  uint32_t kernel;
  // A parfocal_registration_step.
  uint32_t registration_step;
  // A parfocal_decode.
  uint32_t decode;
  // 1: match gain, offset and shading. 0: keep them.
  uint32_t photometric;
  // Pyramid levels, 1 to 12. 0: as many as the image size allows.
  uint32_t levels;
  // Maximum iterations per level, 5 to 1000.
  uint32_t outer_iterations;
  // Relaxation sweeps per outer iteration on each grid but the coarsest, 1 to 100.
  uint32_t relaxation_sweeps;
  // Over-relaxation, 0.01 to 1.99.
  double over_relaxation;
  // Smoothness weight, 1e-6 to 10. 0: estimated on each level.
  double regularization;
  // The smoothness weight of the coarsest level starts larger by the factor 1 + continuation, 0 to 1000.
  double continuation;
  // Robustness scale of the data term, units of intensity (a power of two near the brightest parts), 1e-4 to 1.
  double data_eta;
  // Robustness scale of the smoothness term, px² per pixel, 1e-4 to 100.
  double smoothness_eta;
  // Limit of |V|, px², 1 to 1024. 0: 144, and for a pair that reaches it 1024.
  double max_relative_blur;
  // Limit of the change of V per step, px² of the level, 0.01 to 100; a quarter of |V| where that is more.
  double largest_step;
  // Samples up to this stored value count as clipped at black. NaN: 0 for integers, none for floats.
  double black_level;
  // Samples from this stored value on count as clipped at white. NaN: the largest integer, none for floats.
  double white_level;
  // Start of T, row by row, for points in px from the image centre.
  double start[9];
  // Start of the gain of I2; it stays if photometric is 0.
  double start_gain;
  // Start of the offset after the gain, intensities; it stays if photometric is 0.
  double start_offset;
  // 1: also compute the fused image of a pair. Depth and registration do not need it.
  uint32_t fused;
  // 1: keep the frames of a sweep that do not show the scene of the others. 0: leave them out.
  uint32_t keep_frames;
  // 1: depth edges are as sharp as the scene's, where two layers explain the photographs better.
  uint32_t edges;
  // A parfocal_parallax_search: whether the parallax of a camera that moved between the photographs is found.
  uint32_t parallax;
} parfocal_settings;

// A photograph: rows of pixels with one sample, or with three (red, green, blue). The call copies it before it returns.
typedef struct {
  // sizeof(parfocal_image).
  size_t size;
  // The first sample of the first row, aligned for its type.
  const void *data;
  // Pixels per row.
  uint32_t width;
  // Number of rows.
  uint32_t height;
  // 1 or 3.
  uint32_t channels;
  // A parfocal_depth.
  uint32_t depth;
  // Bytes from the start of one row to the next, a multiple of the sample's size. 0: rows have no gaps.
  size_t row_bytes;
  // GenICam name of a camera's pixel format, for example "Mono12p" or "BayerRG8". channels and depth are then ignored, and
  // data needs no alignment. Rows that do not end on a byte must have no gaps. NULL: channels and depth apply.
  const char *format;
} parfocal_image;

// A rectangle of pixels.
typedef struct {
  // Left edge, px.
  uint32_t x;
  // Upper edge, px.
  uint32_t y;
  // Width, px.
  uint32_t width;
  // Height, px.
  uint32_t height;
} parfocal_region;

// Called after every few iterations by the solving thread, with the share of the solve that is done, 0 to 1. A result other than 0
// cancels the solve. With handles of the same call it may only call parfocal_cancellation_token_cancel. It must return: no
// exception and no longjmp may leave it.
typedef int32_t (*parfocal_progress)(void *context, double done);

// The options of one solve: region, mask, cropping, progress and cancellation.
typedef struct {
  // sizeof(parfocal_solve_options).
  size_t size;
  // The part of I1, or of the reference frame, to solve. Width 0: all of it.
  parfocal_region region;
  // One byte per pixel of I1, row by row without gaps; pixels with 0 do not count. NULL: all pixels count.
  const uint8_t *mask;
  // Not 0: crop results to the largest rectangle in which V is valid everywhere.
  int32_t crop_valid;
  // Called with the share done; may be NULL.
  parfocal_progress progress;
  // Passed to progress.
  void *context;
  // Token that cancels the solve from another thread; may be NULL.
  const parfocal_cancellation_token *cancel;
} parfocal_solve_options;

// The numbers and fields of a solution. Fields have width x height values, row by row without gaps. They live as long as
// the solution.
typedef struct {
  // sizeof(parfocal_solution_view).
  size_t size;
  // Pixels per row of the fields; of a registration, of the photographs.
  uint32_t width;
  // Number of rows.
  uint32_t height;
  // Pixel x, y of I1 at the first value of the fields; (0, 0) unless they are cropped.
  uint32_t origin[2];
  // 1 if the solve converged to a solution that the images support, else 0.
  uint32_t converged;
  // Number of warnings.
  uint32_t warnings;
  // V, px² of I1, positive where I2 is more blurred than I1; NaN where not valid. This and the next four fields are NULL for
  // a registration.
  const float *relative_blur;
  // Standard deviation of V, px²; 1000 where the images do not determine V or it is at its limit, NaN where V is NaN.
  const float *uncertainty;
  // Confidence in V, 0 to 1.
  const float *confidence;
  // The difference that neither blur nor T explains, intensities.
  const float *residual;
  // At each pixel the sharper photograph, intensities, interleaved.
  const float *fused;
  // Channels of fused, 1 or 3. 0 if fused is NULL: for a registration, or if settings.fused is 0.
  uint32_t fused_channels;
  // Always 0.
  uint32_t reserved;
  // T, row by row, for points in px from the image centre; I2(T x) matches I1(x).
  double transform[9];
  // Gain of I2.
  double gain;
  // Offset of I2 after the gain, intensities.
  double offset;
  // Smoothness weight of the finest level, stated or estimated. This and the next four are NaN for a registration.
  double regularization;
  // Shape of the estimated kernel: 0 is a Gaussian, 1 a disk. NaN if the kernel was stated.
  double kernel_shape;
  // Fraction of the pixels that are valid.
  double valid_fraction;
  // Mean confidence of the valid pixels.
  double mean_confidence;
  // Fraction of the valid pixels at the limit of |V|.
  double saturated_fraction;
  // Fraction of the valid pixels below the limit of |V| that the last step moved by more than a tenth of their
  // standard deviation.
  double unsettled_fraction;
  // Fraction of the valid pixels that are not measured because the photographs differ by more than noise and blur.
  double unexplained_fraction;
  // Time from call to return, ms.
  double total_ms;
  // Time on the device, ms.
  double gpu_ms;
  // Fraction of the pixels of I1 and of I2 that are clipped, of those that no mask excludes.
  double clipped_fractions[2];
  // Standard deviation of T at the corner that is determined worst, px, and the direction in which it is, in degrees
  // from the rows. NaN if it is not known.
  double transform_deviation[2];
  // Standard deviation of the scale of V, as a share of V, which the uncertainty includes. NaN for a registration.
  double scale_deviation;
  // How far the two focus settings are apart: the variance of the blur in one photograph of what is in focus in the
  // other, px². NaN if it was not found.
  double separation;
  // Parallax of a camera that moved: a pixel x is displaced by ((parallax[0], parallax[1]) + parallax[2] (x - c)) V before
  // T maps it, c being the image centre. 0 if none was found, NaN for a registration.
  double parallax[3];
  // Standard deviations of these numbers.
  double parallax_deviation[3];
  // Limit of |V|, px², as set or as found. NaN for a registration.
  double max_relative_blur;
} parfocal_solution_view;

// A lens that is focused at one distance for each photograph of a pair. It has no field: V is taken as
// if the lens were the same at every place.
typedef struct {
  // sizeof(parfocal_lens).
  size_t size;
  // Focal length, mm.
  double focal_length;
  // F-number; the aperture is focal_length / f_number wide.
  double f_number;
  // Distance between pixel centres, mm.
  double pixel_pitch;
  // Focus distances of I1 and I2 from the lens, mm.
  double focus[2];
  // Standard deviation of the blur over its radius. 0 means 0.5, a disk.
  double kappa;
  // Not 0 if the lens is telecentric on the image side.
  int32_t telecentric;
} parfocal_lens;

// The options of a focus sweep.
typedef struct {
  // sizeof(parfocal_sweep_options).
  size_t size;
  // Focus position of each frame, ascending or descending. NULL: 0, 1, 2, ..., corrected if the frames show uneven steps.
  const double *positions;
  // A parfocal_position_unit.
  uint32_t unit;
  // The frame whose pixels the results have, counted from 0. -1: the middle frame.
  int32_t reference;
} parfocal_sweep_options;

// The numbers and fields of a sweep. Fields have width x height values, row by row without gaps. They live as long as the
// sweep.
typedef struct {
  // sizeof(parfocal_sweep_view).
  size_t size;
  // Pixels per row.
  uint32_t width;
  // Number of rows.
  uint32_t height;
  // Pixel x, y of the reference at the first value of the fields.
  uint32_t origin[2];
  // Number of solved frames. A frame that occurs twice is left out.
  uint32_t frames;
  // Index of the reference among the solved frames, from 0.
  uint32_t reference;
  // Number of warnings.
  uint32_t warnings;
  // Channels of fused, 1 or 3.
  uint32_t fused_channels;
  // The focus setting at which each pixel is sharp, for distances in 1/m; NaN where it is not measured.
  const float *focus;
  // Standard deviation of focus.
  const float *uncertainty;
  // Depth, mm; NULL unless positions are in mm.
  const float *depth;
  // Standard deviation of depth, mm.
  const float *deviation;
  // -1 where the focus is before the first frame, 1 where it is beyond the last, else 0.
  const int8_t *beyond;
  // The all-in-focus image, intensities, interleaved.
  const float *fused;
  // The frame that each pixel of fused comes from, counted from 1.
  const uint16_t *frame;
  // Growth of the blur variance, px², with the squared distance from focus in settings.
  double blur_rate;
} parfocal_sweep_view;

// A value and its standard error; both are NaN if too few pixels are valid.
typedef struct {
  // The value, in the unit of the field.
  double value;
  // Its standard error.
  double standard_error;
} parfocal_estimate;

// The evaluation of a surface. Zeros are the defaults, except for form, realizations and noise_window_px, which
// parfocal_roughness_options_init sets to a plane, 20 and 4 px.
typedef struct {
  // sizeof(parfocal_roughness_options).
  size_t size;
  // The part of the heights that is evaluated. Width 0: all of it.
  parfocal_region region;
  // One byte per pixel, row by row without gaps; pixels with 0 do not count. NULL: all pixels count.
  const uint8_t *mask;
  // An error of each height of one standard deviation that all heights have in common, which deviation includes: for
  // V scale_deviation times V. In the unit of the heights; where it is NaN or greater than deviation, there is no
  // height. NULL: none.
  const float *common;
  // A parfocal_form.
  int32_t form;
  // Not 0: the robust L-filter of ISO 16610-71.
  int32_t robust;
  // Cutoff wavelength of the S-filter, px. 0: no filter.
  double s_filter_px;
  // Cutoff wavelength of the L-filter, px. 0: no filter.
  double l_filter_px;
  // Ends of the line of Ra, Rq and Rz, px: x1, y1, x2, y2, and the width across it. Width 0: means over the rows.
  double line[5];
  // The size of a pixel on the surface, in the unit of the heights. 0: not known; sdr is then NaN.
  double pixel_size;
  // Standard deviation of the window over which a solve averages noise, px: 4 for a pair, 2 for a sweep.
  double noise_window_px;
  // The number of realizations of noise from which standard deviations follow.
  uint32_t realizations;
  // Always 0.
  uint32_t reserved;
} parfocal_roughness_options;

// A parameter of a surface with its standard deviation. NaN is not determined.
typedef struct {
  // The value.
  double value;
  // The standard deviation: the root of the sum of the squares of both parts.
  double standard_deviation;
  // The part by the noise of each height.
  double by_noise;
  // The part by the error that all heights have in common; 0 if there is none.
  double by_scale;
  // How much noise adds to the parameter. It is not subtracted.
  double noise_bias;
} parfocal_parameter;

// Surface texture: areal parameters of ISO 25178-2 and profile parameters of ISO 21920-2. Those that are heights are
// in the unit of the heights.
typedef struct {
  // sizeof(parfocal_roughness).
  size_t size;
  // Number of pixels of the region that the mask counts.
  size_t area_px;
  // Number of measured pixels in it.
  size_t measured_px;
  // Number of profiles of ra, rq and rz.
  size_t profiles;
  // Number of section lengths of a profile.
  size_t sections;
  // 1 if str is an upper bound.
  int32_t str_is_upper_bound;
  // Always 0.
  int32_t reserved;
  // Arithmetical mean height.
  parfocal_parameter sa;
  // Root mean square height.
  parfocal_parameter sq;
  // Skewness, a number.
  parfocal_parameter ssk;
  // Kurtosis, a number.
  parfocal_parameter sku;
  // Maximum peak height.
  parfocal_parameter sp;
  // Maximum pit depth.
  parfocal_parameter sv;
  // Maximum height.
  parfocal_parameter sz;
  // Root mean square gradient: a number, or unit of the heights per px if pixel_size is 0.
  parfocal_parameter sdq;
  // Developed interfacial area ratio, %.
  parfocal_parameter sdr;
  // Autocorrelation length, px.
  parfocal_parameter sal;
  // Texture aspect ratio, a number.
  parfocal_parameter str;
  // Arithmetical mean height of the profiles.
  parfocal_parameter ra;
  // Root mean square height of the profiles.
  parfocal_parameter rq;
  // Maximum height of the profiles, per section length.
  parfocal_parameter rz;
} parfocal_roughness;

// A value with its interval of 95 %.
typedef struct {
  // The value.
  double value;
  // The lower end.
  double low;
  // The upper end.
  double high;
} parfocal_interval;

// The noise of repeated height maps of one unmoved part, in the unit of the heights.
typedef struct {
  // sizeof(parfocal_repeatability).
  size_t size;
  // Number of pixels of the region that the mask counts.
  size_t area_px;
  // Number of them that all maps measure.
  size_t measured_px;
  // Measurement noise of a map (ISO 25178-700).
  parfocal_estimate noise;
  // Median, least and greatest noise of a pair of maps.
  double pair_noise[3];
  // What two measurements of a pixel differ by in 95 of 100 cases at most.
  parfocal_estimate repeatability_limit;
  // Standard deviation of the mean height between maps.
  parfocal_interval shift_deviation;
  // Root mean square of the stated standard deviations.
  double stated;
  // Differences over their stated standard deviations, root mean square: 1 if these are right.
  parfocal_estimate seen_over_stated;
  // Share of the differences within 1 of their stated standard deviations: 0.683 if these are right.
  parfocal_estimate within_1;
  // Share within 2: 0.954 if these are right.
  parfocal_estimate within_2;
} parfocal_repeatability;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Returns the error message of this thread's last call that returned a status, with what to do; "" after a success. Valid
// until this thread's next such call.
const char *parfocal_last_error(void);

// Returns the version of the library, for example "0.1.0".
const char *parfocal_version(void);

// Opens a device. options may be NULL. One engine per process is enough.
parfocal_status parfocal_engine_new(const parfocal_engine_options *options, parfocal_engine **engine);

// Returns the name of the device; "" if engine is NULL. Valid until the engine is freed.
const char *parfocal_engine_device(const parfocal_engine *engine);

// Returns the validation messages so far, one per line; "" if there are none or engine is NULL. Valid until the next call
// of this function for the engine.
const char *parfocal_engine_messages(const parfocal_engine *engine);

// Frees an engine. Handles made from it stay valid.
void parfocal_engine_free(parfocal_engine *engine);

// Makes an engine on a device of the embedding program, which keeps owning it. options may be NULL; only timeout_s applies.
parfocal_status parfocal_engine_from_vulkan(const parfocal_vulkan *vulkan,
                                            const parfocal_engine_options *options,
                                            parfocal_engine **engine);

// Fills in the defaults. settings->size must be set.
parfocal_status parfocal_settings_init(parfocal_settings *settings);

// Makes a token.
parfocal_status parfocal_cancellation_token_new(parfocal_cancellation_token **cancel);

// Cancels all solves that use this token.
parfocal_status parfocal_cancellation_token_cancel(const parfocal_cancellation_token *cancel);

// Frees a token. Calls that use it continue.
void parfocal_cancellation_token_free(parfocal_cancellation_token *cancel);

// Makes a solver. settings may be NULL.
parfocal_status parfocal_solver_new(const parfocal_engine *engine,
                                    const parfocal_settings *settings,
                                    parfocal_solver **solver);

// Solves a pair. options may be NULL. The first pair of a size and format takes longer.
//
// A pair that does not converge is no error: the solution has converged 0, and its warnings say why.
parfocal_status parfocal_solver_solve(parfocal_solver *solver,
                                      const parfocal_image *i1,
                                      const parfocal_image *i2,
                                      const parfocal_solve_options *options,
                                      parfocal_solution **solution);

// Registers a pair. The fields of the solution are NULL.
parfocal_status parfocal_solver_register(parfocal_solver *solver,
                                         const parfocal_image *i1,
                                         const parfocal_image *i2,
                                         parfocal_solution **solution);

// Frees a solver. Its solutions stay valid.
void parfocal_solver_free(parfocal_solver *solver);

// Fills in the view of a solution. view->size must be set.
parfocal_status parfocal_solution_get(const parfocal_solution *solution, parfocal_solution_view *view);

// Returns a warning, counted from 0, as a UTF-8 sentence; NULL beyond the last. Valid until the solution is freed.
const char *parfocal_solution_warning(const parfocal_solution *solution, uint32_t index);

// Computes depth from the lens and its standard deviation, mm, NaN where there is none. Both fields have count floats,
// width x height of the solution. deviation may be NULL.
parfocal_status parfocal_solution_depth(const parfocal_solution *solution,
                                        const parfocal_lens *lens,
                                        float *depth,
                                        float *deviation,
                                        size_t count);

// Resamples another photograph, taken like I2, onto the pixels of the results. out receives width x height pixels of the
// solution without gaps, with the image's channels and sample type; bytes is its size. Pixels beyond the photograph are
// black. exposure not 0 also matches the brightness of I1.
parfocal_status parfocal_solution_apply(const parfocal_solution *solution,
                                        const parfocal_image *image,
                                        int32_t exposure,
                                        void *out,
                                        size_t bytes);

// Frees a solution and its fields.
void parfocal_solution_free(parfocal_solution *solution);

// Makes a stream on count engines, with slots pairs in flight on each; three keep a device busy. i1 and i2 state the size and
// format of all pairs; their pixels are not read. settings may be NULL. Each pair goes to the first free device. The pairs of
// a device that fails go to the others.
parfocal_status parfocal_stream_new(const parfocal_engine *const *engines,
                                    size_t count,
                                    uint32_t slots,
                                    const parfocal_image *i1,
                                    const parfocal_image *i2,
                                    const parfocal_settings *settings,
                                    parfocal_stream **stream);

// Copies a pair into the stream. Waits up to seconds for room: 0 does not wait; INFINITY waits without limit, for use when
// another thread reads. Returns PARFOCAL_ERROR_FULL if there is no room in time: read a solution first. An error of the pair
// itself, for example another size, is returned when its solution is read.
parfocal_status parfocal_stream_push(const parfocal_stream *stream,
                                     const parfocal_image *i1,
                                     const parfocal_image *i2,
                                     double seconds);

// Reads the solution of the oldest pair that has not been read. Waits up to seconds, as parfocal_stream_push. The solution is
// NULL if it is not ready in time, and after parfocal_stream_finish once all have been read. Returns that pair's error. Later
// pairs are unaffected.
parfocal_status parfocal_stream_next(const parfocal_stream *stream,
                                     double seconds,
                                     parfocal_solution **solution);

// Marks the end of input, so that readers wait only for the remaining pairs. A later push reopens the stream.
parfocal_status parfocal_stream_finish(const parfocal_stream *stream);

// Returns the number of pairs that may be pushed and not yet read, two per slot; 0 if stream is NULL.
size_t parfocal_stream_capacity(const parfocal_stream *stream);

// Returns the number of pairs pushed and not yet read; 0 if stream is NULL.
size_t parfocal_stream_length(const parfocal_stream *stream);

// Frees a stream after the pairs in flight are solved; waiting pairs are dropped. Its solutions stay valid.
void parfocal_stream_free(parfocal_stream *stream);

// Solves a focus sweep: three or more frames of one size and format, in the order of their focus. settings, options and solve
// may be NULL.
parfocal_status parfocal_sweep_solve(const parfocal_engine *engine,
                                     const parfocal_image *frames,
                                     size_t count,
                                     const parfocal_settings *settings,
                                     const parfocal_sweep_options *options,
                                     const parfocal_solve_options *solve,
                                     parfocal_sweep **sweep);

// Fills in the view of a sweep. view->size must be set.
parfocal_status parfocal_sweep_get(const parfocal_sweep *sweep, parfocal_sweep_view *view);

// Writes T of a frame, counted from 0: nine numbers, row by row, for points in px from the image centre. T maps pixels of the
// reference to the frame.
parfocal_status parfocal_sweep_transform(const parfocal_sweep *sweep,
                                         uint32_t frame,
                                         double *transform);

// Writes the parallax of a frame, counted from 0, of a camera that moved: two numbers, to the right and downwards, px per setting.
// What is in focus at u is displaced by (u - m) times this before T, m being the middle between the first and the last position.
parfocal_status parfocal_sweep_parallax(const parfocal_sweep *sweep,
                                        uint32_t frame,
                                        double *parallax);

// Resamples another photograph, taken like one frame, onto the pixels of the results, as parfocal_solution_apply. frame counts
// from 0.
parfocal_status parfocal_sweep_apply(const parfocal_sweep *sweep,
                                     uint32_t frame,
                                     const parfocal_image *image,
                                     int32_t exposure,
                                     void *out,
                                     size_t bytes);

// Returns a warning, counted from 0, as a UTF-8 sentence; NULL beyond the last. Valid until the sweep is freed.
const char *parfocal_sweep_warning(const parfocal_sweep *sweep, uint32_t index);

// Frees a sweep and its fields.
void parfocal_sweep_free(parfocal_sweep *sweep);

// Measures a step in a field of width x height values: the level of region `to` minus that of `from`, in the unit of the
// field. A level is the median after removing the region's tilt.
parfocal_status parfocal_measure_step(const float *values,
                                      uint32_t width,
                                      uint32_t height,
                                      parfocal_region from,
                                      parfocal_region to,
                                      parfocal_estimate *estimate);

// Returns the number of values of a profile along a line, at most 1 px apart, both ends included. 0 if the line is shorter
// than 1 px.
size_t parfocal_profile_length(double x1,
                               double y1,
                               double x2,
                               double y2);

// Samples a field along a line between two points in px. Each value is the mean over `across` px across the line; NaN if no
// pixel is valid. count must be parfocal_profile_length of the line.
parfocal_status parfocal_measure_profile(const float *values,
                                         uint32_t width,
                                         uint32_t height,
                                         double x1,
                                         double y1,
                                         double x2,
                                         double y2,
                                         double across,
                                         double *profile,
                                         size_t count);

// Fills in the default options.
parfocal_status parfocal_roughness_options_init(parfocal_roughness_options *options);

// Evaluates the texture of width x height heights, NaN where there is none, with their standard deviations, in any
// unit. Heights are positive towards the camera: give depth in mm with the opposite sign. options may be NULL.
parfocal_status parfocal_measure_roughness(const float *heights,
                                           const float *deviation,
                                           uint32_t width,
                                           uint32_t height,
                                           const parfocal_roughness_options *options,
                                           parfocal_roughness *found);

// Compares count height maps of one unmoved part, 2 to 200, each of width x height heights with their standard
// deviations: without the part that all maps have in common, such as that of the scale of V. The form, a
// parfocal_form, is subtracted from their differences. region may be NULL: all of the maps. mask has one byte per
// pixel and may be NULL: all pixels count.
parfocal_status parfocal_measure_repeatability(const float *const *heights,
                                               const float *const *deviations,
                                               size_t count,
                                               uint32_t width,
                                               uint32_t height,
                                               const parfocal_region *region,
                                               const uint8_t *mask,
                                               int32_t form,
                                               parfocal_repeatability *found);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* PARFOCAL_H */
