/* Depth from defocus on the GPU: the C interface of parfocal.
 *
 * Made by cbindgen from bindings/c/src; bindings/c/README.md says how to use it.
 *
 * What may fail returns a parfocal_status; parfocal_last_error() then says in words what to do. Structs begin with their size:
 * set it to sizeof, and fields that a later version adds keep their defaults. Handles may move between threads, and one
 * handle is used by one thread at a time; an engine and a stream may be used by several. NULL where there must be a handle is an error,
 * never a crash; freeing NULL does nothing. Images are read in the call alone. A parfocal_cancellation_token may be used by several threads. */

#ifndef PARFOCAL_H
#define PARFOCAL_H

#include <stddef.h>
#include <stdint.h>

// How a call ended.
typedef enum {
  // Done.
  PARFOCAL_OK = 0,
  // A pointer is NULL, a size field not set, a number none of its enumeration, an image not of numbers.
  PARFOCAL_ERROR_INVALID_ARGUMENT = 1,
  // No Vulkan loader, or no device that will do, or none of the name asked for.
  PARFOCAL_ERROR_NO_DEVICE = 2,
  // A Vulkan call failed.
  PARFOCAL_ERROR_VULKAN = 3,
  // The device did not finish in time: a new engine is needed.
  PARFOCAL_ERROR_TIMEOUT = 4,
  // An earlier call timed out or lost the device: a new engine is needed.
  PARFOCAL_ERROR_POISONED = 5,
  // The images are larger than the device takes.
  PARFOCAL_ERROR_TOO_LARGE = 6,
  // The images are too small to find any blur in.
  PARFOCAL_ERROR_TOO_SMALL = 7,
  // Sizes or formats that do not fit each other.
  PARFOCAL_ERROR_MISMATCH = 8,
  // A setting is out of range.
  PARFOCAL_ERROR_INVALID_SETTING = 9,
  // A region or a line is not within the image.
  PARFOCAL_ERROR_INVALID_REGION = 10,
  // A fault of parfocal itself: free the handles of the call, and report it.
  PARFOCAL_ERROR_INTERNAL = 11,
  // Anything else.
  PARFOCAL_ERROR_OTHER = 12,
  // A stream had no room for the pair in time, which was not taken: read a result first.
  PARFOCAL_ERROR_FULL = 13,
  // The call was called off.
  PARFOCAL_ERROR_CANCELLED = 14,
} parfocal_status;

// How a sample is stored.
typedef enum {
  // uint8_t, white at 255.
  PARFOCAL_U8 = 0,
  // uint16_t, white at 65535.
  PARFOCAL_U16 = 1,
  // float, white at 1.
  PARFOCAL_F32 = 2,
} parfocal_depth;

// How registration and relative blur go together.
typedef enum {
  // Together.
  PARFOCAL_UNIFIED = 0,
  // Relative blur alone: T is held at the start.
  PARFOCAL_ALIGNED = 1,
  // Registration first, by the difference of the images; then relative blur.
  PARFOCAL_APPEARANCE = 2,
} parfocal_method;

// What T may be: each is a special case of the next.
typedef enum {
  // A shift.
  PARFOCAL_TRANSLATION = 0,
  // Besides, rotation and scale.
  PARFOCAL_SIMILARITY = 1,
  // Besides, stretch and shear.
  PARFOCAL_AFFINE = 2,
  // Besides, perspective.
  PARFOCAL_HOMOGRAPHY = 3,
} parfocal_motion;

// How T steps.
typedef enum {
  // Gauss-Newton, each pixel's change of V eliminated.
  PARFOCAL_GAUSS_NEWTON = 0,
  // The paper's explicit scheme, to compare with.
  PARFOCAL_GRADIENT_DESCENT = 1,
} parfocal_registration_step;

// Shape of the blur.
typedef enum {
  // What the photographs say, from a Gaussian to a disk and a little beyond.
  PARFOCAL_KERNEL_AUTO = 0,
  // Gaussian.
  PARFOCAL_GAUSSIAN = 1,
  // Disk.
  PARFOCAL_PILLBOX = 2,
  // Half a Gaussian: the paper's asymmetric kernel.
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

// What positions are.
typedef enum {
  // Settings in any unit that is even in 1/distance.
  PARFOCAL_UNIT_STEPS = 0,
  // Distances from the lens at which it is focused, mm.
  PARFOCAL_UNIT_DISTANCES = 1,
  // Where a stage puts the plane in focus, mm from any origin.
  PARFOCAL_UNIT_STAGE = 2,
} parfocal_position_unit;

// Calls solves off, from any thread: what is being solved with it ends soon, with PARFOCAL_ERROR_CANCELLED, and so does all that begins with it
// afterwards. What was used is good for the next call.
typedef struct parfocal_cancellation_token parfocal_cancellation_token;

// A device. What is made of it keeps it, so that it may be freed first.
typedef struct parfocal_engine parfocal_engine;

// What was found of a pair.
typedef struct parfocal_solution parfocal_solution;

// Settings, and what is kept from one pair for the next: memory and the recorded work of pairs of one size and format.
typedef struct parfocal_solver parfocal_solver;

// Many pairs of one size and kind in, their solutions out in the same order: on each device several are under way, so that the next goes up
// and the one before comes down while it solves. One thread may push while another reads.
typedef struct parfocal_stream parfocal_stream;

// What was found of a focus sweep.
typedef struct parfocal_sweep parfocal_sweep;

// How an engine is made.
typedef struct {
  // sizeof(parfocal_engine_options).
  size_t size;
  // Index, part of the name, or UUID of the device, UTF-8; NULL takes the most capable.
  const char *device;
  // The longest wait for one solve, seconds; 0 takes 600.
  double timeout_s;
  // Not 0 turns validation on; it needs the Khronos validation layer.
  int32_t validation;
} parfocal_engine_options;

// An instance and a device of the program's, both made for Vulkan 1.3 or later, the device with the features timelineSemaphore, synchronization2
// and maintenance4. They are not destroyed before the last engine, solver, stream and solution of them is freed.
typedef struct {
  // sizeof(parfocal_vulkan).
  size_t size;
  // The vkGetInstanceProcAddr that the instance came by.
  const void *get_instance_proc_addr;
  // The VkInstance.
  const void *instance;
  // The VkPhysicalDevice.
  const void *physical_device;
  // The VkDevice.
  const void *device;
  // A VkQueue of it that computes, which nobody else uses, unless all do between lock and unlock.
  const void *queue;
  // Its family.
  uint32_t queue_family;
  // Not 0 where the device was made with VK_EXT_conditional_rendering and its feature conditionalRendering: a solve is then one submission.
  int32_t conditional_rendering;
  // Waits until nobody else uses the queue, and keeps others from it until unlock is called, by the same thread, after one submission;
  // NULL: nobody else uses it.
  void (*lock)(void *context);
  // Lets others have the queue.
  void (*unlock)(void *context);
  // What both are called with, from any thread.
  void *context;
} parfocal_vulkan;

// The settings; docs/method.md, section 8, says what each does. parfocal_settings_init fills in the defaults.
typedef struct {
  // sizeof(parfocal_settings).
  size_t size;
  // A parfocal_method.
  uint32_t method;
  // A parfocal_motion: what T may be, beyond where it starts.
  uint32_t motion;
  // A parfocal_kernel.
  uint32_t kernel;
  // A parfocal_registration_step.
  uint32_t registration_step;
  // A parfocal_decode.
  uint32_t decode;
  // Whether gain, offset and shading are matched: 1 or 0.
  uint32_t photometric;
  // Pyramid levels, 1 to 12; 0: as many as the images have.
  uint32_t levels;
  // Iterations a level at most, 5 to 1000.
  uint32_t outer_iterations;
  // Relaxation sweeps per outer iteration, 1 to 100.
  uint32_t relaxation_sweeps;
  // Over-relaxation, 0.01 to 1.99.
  double over_relaxation;
  // Smoothness, 1e-6 to 10; 0: found on each level.
  double regularization;
  // The smoothness starts 1 + this times too large, 0 to 1000.
  double continuation;
  // Of the data term, intensities, 1e-4 to 1.
  double data_eta;
  // Of the smoothness, px² a pixel, 1e-4 to 100.
  double smoothness_eta;
  // Px², 1e-3 to 10.
  double heaviside_epsilon;
  // Largest |V|, px², 1 to 256.
  double max_relative_blur;
  // Largest change of V an iteration, px² of the level, 0.01 to 100.
  double largest_step;
  // Stored value up to which a sample is clipped at black; NaN: 0 of integers, nothing of floats.
  double black_level;
  // Stored value from which on a sample is clipped at white; NaN: the greatest of integers, nothing of floats.
  double white_level;
  // Where T starts, by rows: of points from the image centre, px.
  double start[9];
  // Where the factor on I2 starts; it stays where photometric is 0.
  double start_gain;
  // Where what is added after it starts, intensities.
  double start_offset;
  // Whether the fused image of a pair is made, of which depth and registration need nothing: 1 or 0.
  uint32_t fused;
  // 0.
  uint32_t reserved;
} parfocal_settings;

// A photograph: rows of pixels of one sample or of three, red, green, blue. It is copied before the call returns.
typedef struct {
  // sizeof(parfocal_image).
  size_t size;
  // The first sample of the first row, aligned as a sample is.
  const void *data;
  // Pixels a row.
  uint32_t width;
  // Rows.
  uint32_t height;
  // 1 or 3.
  uint32_t channels;
  // A parfocal_depth.
  uint32_t depth;
  // From the start of a row to that of the next, a multiple of a sample; 0 where rows follow one another without a gap.
  size_t row_bytes;
  // How a camera packs pixels, by GenICam's name, such as "Mono12p" or "BayerRG8": then channels and depth say nothing, data needs not
  // be aligned, and rows that are not whole bytes have no gaps. NULL: as channels and depth say.
  const char *format;
} parfocal_image;

// A rectangle of pixels.
typedef struct {
  // Left edge, px.
  uint32_t x;
  // Upper edge, px.
  uint32_t y;
  // Px.
  uint32_t width;
  // Px.
  uint32_t height;
} parfocal_region;

// Is told by the thread that solves which share of a solve is done, 0 to 1, after each level, and calls it off by what is not 0. It calls no
// function of parfocal with a handle of the same call but parfocal_cancellation_token_cancel, and returns: no exception or longjmp leaves it.
typedef int32_t (*parfocal_progress)(void *context, double done);

// What of a pair is solved, who is told how far it is, and what calls it off.
typedef struct {
  // sizeof(parfocal_solve_options).
  size_t size;
  // The part of I1 that results are wanted of; of a width of 0: all.
  parfocal_region region;
  // A byte a pixel of I1, row by row without gaps, 0 where a pixel is left out; NULL leaves out none.
  const uint8_t *mask;
  // Not 0 crops results to the largest rectangle in which V is valid everywhere.
  int32_t crop_valid;
  // Is told how far the call is; NULL: nobody.
  parfocal_progress progress;
  // What that is called with.
  void *context;
  // What calls the call off, from another thread; NULL: nothing.
  const parfocal_cancellation_token *cancel;
} parfocal_solve_options;

// What was found of a pair: fields are row by row without gaps, width x height, and live as long as the solution.
typedef struct {
  // sizeof(parfocal_solution_view).
  size_t size;
  // Pixels a row of the fields; of a registration, of the photographs.
  uint32_t width;
  // Rows.
  uint32_t height;
  // The pixel of I1 that is the first of the fields: (0, 0) unless they were cropped.
  uint32_t origin[2];
  // Whether the solve settled on an answer that the images support: 1 or 0.
  uint32_t converged;
  // How many warnings there are.
  uint32_t warnings;
  // V, px² of I1, positive where I2 is the more blurred; NaN where not valid. NULL of a registration, as the next four.
  const float *relative_blur;
  // Standard deviation of V, px²; 1000 where the images say nothing, NaN where V is.
  const float *uncertainty;
  // 0 to 1.
  const float *confidence;
  // What neither blur nor T explains, intensities.
  const float *residual;
  // Of each pixel the sharper photograph, intensities, interleaved.
  const float *fused;
  // Channels of fused, 1 or 3; 0 of a registration, and where none was asked for: then fused is NULL.
  uint32_t fused_channels;
  // 0.
  uint32_t reserved;
  // T by rows: of points from the image centre, px; I2(T x) lines up with I1(x).
  double transform[9];
  // Factor on I2.
  double gain;
  // Added after it, intensities.
  double offset;
  // Smoothness of the finest level, stated or found; NaN of a registration, as the next four.
  double regularization;
  // Where the kernel was to be found: 0 is a Gaussian, 1 a disk; NaN where it was stated.
  double kernel_shape;
  // Fraction of pixels that are valid.
  double valid_fraction;
  // Mean confidence of the valid pixels.
  double mean_confidence;
  // Fraction of the valid pixels at the limit of |V|.
  double saturated_fraction;
  // From the call to the answer, ms.
  double total_ms;
  // On the device, ms.
  double gpu_ms;
} parfocal_solution_view;

// A lens in front of the sensor, focused at one distance for each of the two photographs.
typedef struct {
  // sizeof(parfocal_lens).
  size_t size;
  // Mm.
  double focal_length;
  // The aperture is focal_length / f_number wide.
  double f_number;
  // Between the centres of neighbouring pixels, mm.
  double pixel_pitch;
  // At which I1 and I2 are focused, mm from the lens.
  double focus[2];
  // Deviation of the blur over its radius; 0 takes that of a disk, 0.5.
  double kappa;
  // Not 0 where the lens is telecentric on the image side.
  int32_t telecentric;
} parfocal_lens;

// How a sweep is solved.
typedef struct {
  // sizeof(parfocal_sweep_options).
  size_t size;
  // What each frame is focused at, ascending or descending; NULL: counted from 0, evenly unless the sweep says otherwise.
  const double *positions;
  // A parfocal_position_unit.
  uint32_t unit;
  // The frame on whose pixels the results are, counted from 0; -1: the middle one.
  int32_t reference;
} parfocal_sweep_options;

// What was found of a sweep: fields are row by row without gaps, width x height, and live as long as the sweep.
typedef struct {
  // sizeof(parfocal_sweep_view).
  size_t size;
  // Pixels a row.
  uint32_t width;
  // Rows.
  uint32_t height;
  // The pixel of the reference that is the first of the fields.
  uint32_t origin[2];
  // How many frames were solved: one that was there twice is left out.
  uint32_t frames;
  // The reference among them, from 0.
  uint32_t reference;
  // How many warnings there are.
  uint32_t warnings;
  // Channels of fused, 1 or 3.
  uint32_t fused_channels;
  // The setting at which each pixel is in focus, 1/m of distances; NaN where none is known.
  const float *focus;
  // Its standard deviation.
  const float *uncertainty;
  // Depth, mm, where positions are in mm; else NULL.
  const float *depth;
  // Its standard deviation, mm.
  const float *deviation;
  // -1 where the focus lies before the first frame, 1 beyond the last, else 0.
  const int8_t *beyond;
  // The image sharp all over, intensities, interleaved.
  const float *fused;
  // The frame that each pixel of it is of, from 1.
  const uint16_t *frame;
  // By how many px² of variance blur grows with the squared distance from the focus, in settings.
  double blur_rate;
} parfocal_sweep_view;

// A number and its standard error, both NaN where too few pixels are valid.
typedef struct {
  // The number, in the unit of the field.
  double value;
  // Its standard error.
  double standard_error;
} parfocal_estimate;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// What the last call of this thread that returned a status failed by, and what to do; "" where it did not fail. Valid until
// this thread's next such call.
const char *parfocal_last_error(void);

// The version of the library, as in "0.1.0".
const char *parfocal_version(void);

// Opens a device; options may be NULL. One engine a process is enough.
parfocal_status parfocal_engine_new(const parfocal_engine_options *options, parfocal_engine **engine);

// The name of the device; "" of NULL. Valid until the engine is freed.
const char *parfocal_engine_device(const parfocal_engine *engine);

// What validation has said so far, a line each; "" where nothing, or of NULL. Valid until the next call of this for the engine.
const char *parfocal_engine_messages(const parfocal_engine *engine);

// Frees an engine; what was made of it lives on.
void parfocal_engine_free(parfocal_engine *engine);

// An engine on a device of the program's, which keeps it; of the options, which may be NULL, timeout_s counts alone.
parfocal_status parfocal_engine_from_vulkan(const parfocal_vulkan *vulkan,
                                            const parfocal_engine_options *options,
                                            parfocal_engine **engine);

// Fills in the defaults; settings->size must be set.
parfocal_status parfocal_settings_init(parfocal_settings *settings);

// Makes one.
parfocal_status parfocal_cancellation_token_new(parfocal_cancellation_token **cancel);

// Calls off what is being solved with it.
parfocal_status parfocal_cancellation_token_cancel(const parfocal_cancellation_token *cancel);

// Frees it; calls that have it go on.
void parfocal_cancellation_token_free(parfocal_cancellation_token *cancel);

// Prepares for pairs; settings may be NULL.
parfocal_status parfocal_solver_new(const parfocal_engine *engine,
                                    const parfocal_settings *settings,
                                    parfocal_solver **solver);

// Solves a pair; scope may be NULL. A pair of another size or format than the last takes longer.
//
// A pair that can be read but not solved is no error: it is a solution that has not converged, whose warnings say why.
parfocal_status parfocal_solver_solve(parfocal_solver *solver,
                                      const parfocal_image *i1,
                                      const parfocal_image *i2,
                                      const parfocal_solve_options *scope,
                                      parfocal_solution **solution);

// Registers a pair: a solution without fields, which are NULL.
parfocal_status parfocal_solver_register(parfocal_solver *solver,
                                         const parfocal_image *i1,
                                         const parfocal_image *i2,
                                         parfocal_solution **solution);

// Frees a solver; its solutions live on.
void parfocal_solver_free(parfocal_solver *solver);

// Fills in what was found; found->size must be set.
parfocal_status parfocal_solution_get(const parfocal_solution *solution, parfocal_solution_view *found);

// A warning, counted from 0, a sentence of UTF-8; NULL where there is none. Valid until the solution is freed.
const char *parfocal_solution_warning(const parfocal_solution *solution, uint32_t index);

// Depth from the lens and its standard deviation, mm, into two fields of count floats each, width x height of the solution;
// NaN where there is none. deviation may be NULL.
parfocal_status parfocal_solution_depth(const parfocal_solution *solution,
                                        const parfocal_lens *lens,
                                        float *depth,
                                        float *deviation,
                                        size_t count);

// Brings another photograph of I2's camera onto the pixels of the results: width x height of the solution, in the image's own
// samples, without gaps, into as many bytes; black beyond the photograph. With exposure not 0, as bright as I1.
parfocal_status parfocal_solution_apply(const parfocal_solution *solution,
                                        const parfocal_image *image,
                                        int32_t exposure,
                                        void *out,
                                        size_t bytes);

// Frees a solution, and the fields with it.
void parfocal_solution_free(parfocal_solution *solution);

// Prepares devices, count of them, with so many slots each (three keep a device busy), for pairs like i1 and i2, of which no pixel is read;
// settings may be NULL. Each pair goes to whichever device is free; what a device that fails had the others solve.
parfocal_status parfocal_stream_new(const parfocal_engine *const *engines,
                                    size_t count,
                                    uint32_t slots,
                                    const parfocal_image *i1,
                                    const parfocal_image *i2,
                                    const parfocal_settings *settings,
                                    parfocal_stream **stream);

// Copies a pair and hands it over, once there is room for it, for which it waits so many seconds at most: 0 does not wait, INFINITY for ever,
// which is of use where another thread reads. PARFOCAL_ERROR_FULL where there was no room: read a solution first. What is wrong with
// a pair, another size say, is told where its solution is read.
parfocal_status parfocal_stream_push(const parfocal_stream *stream,
                                     const parfocal_image *i1,
                                     const parfocal_image *i2,
                                     double seconds);

// The solution of the oldest pair that has not been read, for which it waits so many seconds at most, as parfocal_stream_push. NULL
// where it is not there by then, and after parfocal_stream_finish at once where all have been read. Fails of what that pair failed of; those
// behind it go on.
parfocal_status parfocal_stream_next(const parfocal_stream *stream,
                                     double seconds,
                                     parfocal_solution **solution);

// Says that no more pairs come, so that who reads waits for the last and no longer. Another push takes it back.
parfocal_status parfocal_stream_finish(const parfocal_stream *stream);

// How many pairs may be pushed and not yet read, two for each slot: only reading makes room; 0 of NULL.
size_t parfocal_stream_capacity(const parfocal_stream *stream);

// How many pairs were pushed and not yet read; 0 of NULL.
size_t parfocal_stream_length(const parfocal_stream *stream);

// Frees a stream, once the devices have solved what they have; what waits is forgotten. Its solutions live on.
void parfocal_stream_free(parfocal_stream *stream);

// Solves a focus sweep of three or more frames of one size and format, in the order of their focus; settings, options and scope
// may be NULL.
parfocal_status parfocal_sweep_solve(const parfocal_engine *engine,
                               const parfocal_image *frames,
                               size_t count,
                               const parfocal_settings *settings,
                               const parfocal_sweep_options *options,
                               const parfocal_solve_options *scope,
                               parfocal_sweep **sweep);

// Fills in what was found; found->size must be set.
parfocal_status parfocal_sweep_get(const parfocal_sweep *sweep, parfocal_sweep_view *found);

// Where the pixels of the reference lie in a frame, counted from 0: T by rows, nine numbers, of points from the image centre, px.
parfocal_status parfocal_sweep_transform(const parfocal_sweep *sweep,
                                         uint32_t frame,
                                         double *transform);

// Brings another photograph of a frame, counted from 0, onto the pixels of the results, as parfocal_solution_apply does.
parfocal_status parfocal_sweep_apply(const parfocal_sweep *sweep,
                                     uint32_t frame,
                                     const parfocal_image *image,
                                     int32_t exposure,
                                     void *out,
                                     size_t bytes);

// A warning, counted from 0, a sentence of UTF-8; NULL where there is none. Valid until the sweep is freed.
const char *parfocal_sweep_warning(const parfocal_sweep *sweep, uint32_t index);

// Frees a sweep, and the fields with it.
void parfocal_sweep_free(parfocal_sweep *sweep);

// How far a region of a field, width x height values, lies above another: the difference of their levels, medians without
// the tilt. For px² or mm.
parfocal_status parfocal_measure_step(const float *values,
                                      uint32_t width,
                                      uint32_t height,
                                      parfocal_region from,
                                      parfocal_region to,
                                      parfocal_estimate *estimate);

// How many values a profile has: places 1 px apart at most, from end to end; 0 of a line without a length.
size_t parfocal_profile_length(double x1, double y1, double x2, double y2);

// The values of a field along a line, px, each the mean over so many px across; NaN where none is valid. count is
// parfocal_profile_length of the line.
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

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* PARFOCAL_H */
