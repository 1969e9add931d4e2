//! What is told while a solve is under way.

/// How far a solve has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Levels done; with the method appearance those of the registration count too.
    pub done: u32,
    /// Levels in all.
    pub levels: u32,
    /// Pixels of the levels done, which is nearer to the time spent than their number.
    pub pixels_done: u64,
    /// Pixels of all levels.
    pub pixels: u64,
    /// Width of the level just done, pixels.
    pub width: u32,
    /// Height of the level just done, pixels.
    pub height: u32,
}

impl Progress {
    /// Which share is done, 0 to 1, by pixels.
    pub fn share(&self) -> f64 {
        self.pixels_done as f64 / self.pixels.max(1) as f64
    }
}
