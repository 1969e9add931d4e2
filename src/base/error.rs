//! The errors of the library.

/// An error of the library. Its message states what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The Vulkan loader is not installed.
    #[error(
        "no Vulkan loader on this machine ({0}): install the GPU's driver (on Debian also libvulkan1), or name no device to use the processor"
    )]
    NoLoader(String),
    /// No device meets the requirements.
    #[error("no Vulkan device that parfocal can use{0}: install a GPU driver, or name no device to use the processor")]
    NoDevice(String),
    /// No device matches the requested name.
    #[error("no device matches '{wanted}'; there are: {available}")]
    NoSuchDevice {
        /// The requested index, name or UUID.
        wanted: String,
        /// The available devices.
        available: String,
    },
    /// A Vulkan call failed.
    #[error("{call} failed on {device}: {result}{advice}")]
    Vulkan {
        /// The name of the call, or the action and the pass.
        call: String,
        /// The name of the device.
        device: String,
        /// The `VkResult`.
        result: String,
        /// Advice, or an empty string.
        advice: &'static str,
    },
    /// The device exceeded the time limit of a solve.
    #[error(
        "{device} did not finish within {seconds} s: try a smaller image, fewer outer iterations, or a longer timeout (a library needs a new Engine first, unless the device is cpu)"
    )]
    Timeout {
        /// The name of the device.
        device: String,
        /// The time limit, s.
        seconds: u64,
    },
    /// All frames in flight of a solver are in use.
    #[error(
        "all {frames} frames in flight of the solver are in use: drop a pending pair first, or make the solver with more"
    )]
    Busy {
        /// The number of frames in flight of the solver.
        frames: usize,
    },
    /// A [`CancellationToken`](crate::CancellationToken) cancelled the solve.
    #[error("the solve was cancelled")]
    Cancelled,
    /// An earlier wait timed out or failed, so that the device may still use this engine's memory.
    #[error("an earlier wait for this engine's device failed, and it may still be busy: make a new Engine")]
    Poisoned,
    /// The images, or the memory for a solve, exceed a limit of the device.
    #[error(
        "{width}x{height} is too large for {device}: {what} needs {needed}, and there is {limit}; use smaller images or another device"
    )]
    TooLarge {
        /// Width, px.
        width: u32,
        /// Height, px.
        height: u32,
        /// The name of the device.
        device: String,
        /// The limit.
        what: &'static str,
        /// The required amount, with its unit.
        needed: String,
        /// The available amount, with its unit.
        limit: String,
    },
    /// The images are smaller than the minimum.
    #[error("{width}x{height} is too small: parfocal needs images of at least {least}x{least} pixels")]
    TooSmall {
        /// Width, px.
        width: u32,
        /// Height, px.
        height: u32,
        /// The minimum width and height, px.
        least: u32,
    },
    /// The method SIFT needs [`EngineOptions::key_points`](crate::EngineOptions::key_points).
    #[error(
        "the method sift needs key-points: make the Engine with EngineOptions::key_points, or use the method unified"
    )]
    NoKeyPoints,
    /// The system refuses a thread.
    #[error("no thread for {device}: {problem}; there are too many, or too little memory")]
    NoThread {
        /// The name of the device.
        device: String,
        /// The message of the system.
        problem: String,
    },
    /// An argument does not fit the others, such as a frame of another size than the solver's.
    #[error("{0}")]
    Mismatch(String),
    /// A setting is out of range.
    #[error("{name} is {value}, and must be {range}")]
    Setting {
        /// The name of the setting.
        name: &'static str,
        /// The value.
        value: f64,
        /// The valid range.
        range: String,
    },
    /// The densities of a kernel are invalid.
    #[error("kernel {name}: {problem}")]
    Kernel {
        /// The name of the kernel.
        name: String,
        /// The problem.
        problem: String,
    },
    /// SIFT found too few key-points to register two images.
    #[error(
        "SIFT cannot register the images: {found} {what} where {least} are needed; use the method unified or appearance, which need no key-points"
    )]
    TooFewKeyPoints {
        /// The counted items.
        what: &'static str,
        /// The number of items.
        found: usize,
        /// The required number.
        least: usize,
    },
    /// A region, line or target is outside the image, or has too few valid pixels.
    #[error("{0}")]
    Region(String),
    /// A file could not be read or written, or does not hold what it should.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
}

impl Error {
    /// A file, and what is wrong with it.
    pub(crate) fn file(path: &std::path::Path, problem: impl Into<String>) -> Self {
        Self::File { path: path.to_path_buf(), problem: problem.into() }
    }
}
