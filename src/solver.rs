//! Submit and wait.

use crate::{Engine, Error, Format, Frame, Settings, Solution};

/// How far a solve has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Levels done.
    pub done: u32,
    /// Levels in all.
    pub levels: u32,
    /// Width of the level just done, pixels.
    pub width: u32,
    /// Height of the level just done, pixels.
    pub height: u32,
}

/// A size and settings, prepared once and used for any number of pairs.
pub struct Solver {}

impl Solver {
    /// Prepares for pairs of `width` x `height` pixels, I1 and I2 in the given formats.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`], [`Error::Vulkan`].
    pub fn new(_engine: &Engine, _width: u32, _height: u32, _formats: [Format; 2], _settings: &Settings) -> Result<Self, Error> {
        Err(Error::NoDevice(String::new()))
    }

    /// Prepares for pairs like this one.
    ///
    /// # Errors
    /// As [`Solver::new`], and [`Error::Mismatch`] where the sizes differ.
    pub fn for_pair(engine: &Engine, i1: &Frame, i2: &Frame, settings: &Settings) -> Result<Self, Error> {
        Self::new(engine, i1.width(), i1.height(), [i1.format(), i2.format()], settings)
    }

    /// Solves one pair.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where a frame is not of the size and format prepared for, [`Error::Timeout`],
    /// [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn solve(&mut self, i1: &Frame, i2: &Frame) -> Result<Solution, Error> {
        self.solve_with(i1, i2, &mut |_| ())
    }

    /// Solves one pair and tells after each level how far it has come.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn solve_with(&mut self, _i1: &Frame, _i2: &Frame, _progress: &mut dyn FnMut(Progress)) -> Result<Solution, Error> {
        Err(Error::NoDevice(String::new()))
    }
}
