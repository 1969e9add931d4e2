//! Depth where it becomes known later at what distances the frames of a solved sweep are focused.

use super::{Positions, SweepDepth};
use crate::base::Error;

impl Positions {
    /// Depth of a sweep that was solved with the focus settings `solved`, if its frames are focused at these positions; `None` where they are
    /// not in mm. Between two frames the settings are interpolated linearly, in 1/mm of distances or mm of a stage, and extrapolated
    /// beyond the ends.
    ///
    /// # Errors
    /// Those of [`Positions::check`].
    pub fn depth_of(&self, solved: &[f64], focus: &[f32], uncertainty: &[f32]) -> Result<Option<SweepDepth>, Error> {
        self.check(solved.len())?;
        let map = Between { from: solved, to: &self.settings(solved.len()) };
        let (focus, uncertainty): (Vec<f32>, Vec<f32>) =
            focus.iter().zip(uncertainty).map(|(&u, &sigma)| map.of(u, sigma)).unzip();
        Ok(self.depth(&focus, &uncertainty))
    }
}

/// From settings to others, both of the same frames and in order; of three frames or more.
struct Between<'a> {
    from: &'a [f64],
    to: &'a [f64],
}

impl Between<'_> {
    /// A setting and its deviation.
    fn of(&self, u: f32, sigma: f32) -> (f32, f32) {
        let (u, last) = (f64::from(u), self.from.len() - 1);
        let descending = self.from[last] < self.from[0];
        let before = self.from.partition_point(|&p| if descending { p > u } else { p < u });
        let i = before.clamp(1, last);
        let slope = (self.to[i] - self.to[i - 1]) / (self.from[i] - self.from[i - 1]);
        let at = self.to[i - 1] + slope * (u - self.from[i - 1]);
        (at as f32, (slope.abs() * f64::from(sigma)) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_frames_settings_run_evenly_and_beyond_they_go_on() {
        let (up, down) = ([0.0, 1.0, 2.0], [2.0, 1.0, 0.0]);
        let map = Between { from: &up, to: &[10.0, 8.0, 4.0] };
        let found = [-0.5, 0.0, 0.5, 1.0, 1.5, 2.5].map(|u| map.of(u, 0.1));
        assert_eq!(found.map(|f| f.0), [11.0, 10.0, 9.0, 8.0, 6.0, 2.0]);
        assert_eq!(found.map(|f| f.1), [0.2, 0.2, 0.2, 0.2, 0.4, 0.4]);
        assert!(map.of(f32::NAN, f32::NAN).0.is_nan());
        let map = Between { from: &down, to: &up };
        assert_eq!([2.5, 1.5, -1.0].map(|u| map.of(u, 0.0).0), [-0.5, 0.5, 3.0]);
    }
}
