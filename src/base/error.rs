//! What can go wrong, and what to do about it.

/// Every failure of the library. Messages say what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The Vulkan loader is not installed.
    #[error(
        "no Vulkan loader on this machine ({0}): install one, with a driver (Debian: libvulkan1 mesa-vulkan-drivers; from a clone: tools/setup)"
    )]
    NoLoader(String),
    /// There is a loader but no device that will do.
    #[error(
        "no Vulkan device that parfocal can use{0}: install a GPU driver, or Mesa's lavapipe (Debian: mesa-vulkan-drivers)"
    )]
    NoDevice(String),
    /// No device answers to the name asked for.
    #[error("no device matches '{wanted}'; there are: {available}")]
    NoSuchDevice {
        /// What was asked for.
        wanted: String,
        /// The devices there are.
        available: String,
    },
    /// A Vulkan call failed.
    #[error("{call} failed on {device}: {result}{advice}")]
    Vulkan {
        /// The call, or the pass.
        call: String,
        /// The device's name.
        device: String,
        /// The VkResult, in words.
        result: String,
        /// What to do, or nothing.
        advice: &'static str,
    },
    /// The device did not finish in time.
    #[error(
        "{device} did not finish within {seconds} s: try a smaller image, fewer outer iterations, or a longer timeout (a library needs a new Engine first)"
    )]
    Timeout {
        /// The device's name.
        device: String,
        /// The limit that it ran into.
        seconds: u64,
    },
    /// All frames in flight of a solver are in use.
    #[error(
        "all {frames} frames in flight of the solver are in use: drop a pending pair first, or make the solver with more"
    )]
    Busy {
        /// How many the solver has.
        frames: usize,
    },
    /// The solve was cancelled.
    #[error("the solve was cancelled")]
    Cancelled,
    /// An earlier wait timed out or failed, so the device may still be using this engine's memory.
    #[error("an earlier wait for this engine's device failed, and it may still be at work: make a new Engine")]
    Poisoned,
    /// The image, or what must be kept for it, is larger than the device takes.
    #[error(
        "{width}x{height} is too large for {device}: {what} needs {needed}, and there is {limit}; use smaller images or another device"
    )]
    TooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// The device's name.
        device: String,
        /// Which limit was met.
        what: &'static str,
        /// What would be needed, with its unit.
        needed: String,
        /// What there is, with its unit.
        limit: String,
    },
    /// The image is too small to find any blur in.
    #[error("{width}x{height} is too small: parfocal needs images of at least {least}x{least} pixels")]
    TooSmall {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// The least width and height.
        least: u32,
    },
    /// The method SIFT, of an engine that was not told how to find key-points.
    #[error(
        "the method sift needs key-points: make the Engine with EngineOptions::key_points, or use the method unified"
    )]
    NoKeyPoints,
    /// The system gives no thread for a device's work.
    #[error("no thread for {device}: {problem}; there are too many, or too little memory")]
    NoThread {
        /// The device's name.
        device: String,
        /// What the system says.
        problem: String,
    },
    /// A frame is not of the size or format that the solver was prepared for.
    #[error("{0}")]
    Mismatch(String),
    /// A setting is out of range.
    #[error("{name} is {value}, and must be {range}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: String,
    },
    /// What was given as a kernel is none.
    #[error("kernel {name}: {problem}")]
    Kernel {
        /// The kernel.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// SIFT found too little to register two images by.
    #[error(
        "SIFT cannot register the images: {found} {what} where {least} are needed; use the method unified or appearance, which need no key-points"
    )]
    TooFewKeyPoints {
        /// What was counted.
        what: &'static str,
        /// How many there were.
        found: usize,
        /// How many it takes.
        least: usize,
    },
    /// A region, a line or a target is not in the image, or holds too little to measure.
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
