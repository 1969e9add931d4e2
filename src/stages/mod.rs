//! stages
pub mod field;
pub mod spline;
pub mod convolve;
pub mod linearise;
pub mod stack;
