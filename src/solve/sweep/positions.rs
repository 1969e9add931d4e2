//! The focus settings of the frames of a sweep, and depth in mm from them.

use crate::base::Error;

/// The focus setting of each frame, ascending or descending.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Positions {
    /// Unknown settings: counted from 0 in even steps. If the sweep shows that frames are missing or steps are uneven,
    /// the settings found are used instead, and a warning states them
    /// ([`RegisteredSweep::positions`](super::RegisteredSweep::positions)).
    #[default]
    Counted,
    /// Settings in any unit that is even in 1/z.
    Settings(Vec<f64>),
    /// Focus distances of a lens that is refocused, mm from the lens. The settings are their inverses in 1/m, in which
    /// blur is linear (`docs/method.md`, section 11).
    Distances(Vec<f64>),
    /// Positions of the plane in focus along the axis, mm from any origin. They are the settings. For a stage that
    /// moves camera or scene, or a lens that is telecentric on the object side.
    Stage(Vec<f64>),
}

/// The most by which a step differs from the mean of its neighbours, twice, in mean steps, of steps that grow evenly.
const MOST_BEND: f64 = 0.35;

/// Converts 1/mm to 1/m, and back.
const PER_METRE: f64 = 1e3;

impl Positions {
    /// Checks that there is one position for each frame, and that they ascend or descend.
    ///
    /// # Errors
    /// [`Error::Mismatch`].
    pub fn check(&self, frames: usize) -> Result<(), Error> {
        let mismatch = |problem: String| Err(Error::Mismatch(problem));
        let Some(stated) = self.stated() else { return Ok(()) };
        if stated.len() != frames {
            return mismatch(format!("{} positions for {frames} frames: give one for each", stated.len()));
        }
        if let (Self::Distances(_), Some(u)) = (self, stated.iter().find(|u| **u <= 0.0)) {
            return mismatch(format!("{u} mm is no distance to be focused at: distances from the lens are positive"));
        }
        let ordered = |by: fn(&f64, &f64) -> bool| stated.windows(2).all(|p| by(&p[0], &p[1]));
        if !stated.iter().all(|p| p.is_finite()) || !(ordered(f64::lt) || ordered(f64::gt)) {
            return mismatch("the positions are not in order: give them ascending or descending".to_string());
        }
        Ok(())
    }

    fn stated(&self) -> Option<&[f64]> {
        match self {
            Self::Counted => None,
            Self::Settings(p) | Self::Distances(p) | Self::Stage(p) => Some(p),
        }
    }

    /// The positions of these frames, by their index.
    pub(super) fn of(&self, frames: &[usize]) -> Self {
        let of = |stated: &[f64]| frames.iter().map(|n| stated[*n]).collect();
        match self {
            Self::Counted => Self::Counted,
            Self::Settings(p) => Self::Settings(of(p)),
            Self::Distances(p) => Self::Distances(of(p)),
            Self::Stage(p) => Self::Stage(of(p)),
        }
    }

    /// The focus position of each frame, mm, if it is known.
    pub fn millimetres(&self) -> Option<&[f64]> {
        match self {
            Self::Counted | Self::Settings(_) => None,
            Self::Distances(z) | Self::Stage(z) => Some(z),
        }
    }

    /// The focus settings, in which blur is linear.
    pub(super) fn settings(&self, frames: usize) -> Vec<f64> {
        match self {
            Self::Counted => (0..frames).map(|n| n as f64).collect(),
            Self::Settings(p) | Self::Stage(p) => p.clone(),
            Self::Distances(u) => u.iter().map(|u| PER_METRE / u).collect(),
        }
    }

    /// The unit of the settings.
    pub fn unit(&self) -> &'static str {
        match self {
            Self::Counted | Self::Settings(_) => "settings",
            Self::Distances(_) => "1/m",
            Self::Stage(_) => "mm",
        }
    }

    /// Whether the first frame is focused nearer than the last; `None` if only settings are known.
    pub fn first_is_nearest(&self) -> Option<bool> {
        self.millimetres().map(|z| z.first() < z.last())
    }

    /// Depth for settings and their standard deviations; `None` if only the settings are known.
    pub(super) fn depth(&self, focus: &[f32], uncertainty: &[f32]) -> Option<SweepDepth> {
        let pixels = focus.iter().zip(uncertainty).map(|(&u, &sigma)| (f64::from(u), f64::from(sigma)));
        let (depth, deviation): (Vec<f32>, Vec<f32>) = match self {
            Self::Counted | Self::Settings(_) => return None,
            Self::Stage(_) => (focus.to_vec(), uncertainty.to_vec()),
            Self::Distances(_) => pixels.map(|(u, sigma)| distance(u, sigma)).unzip(),
        };
        let out_of_range = focus.iter().zip(&depth).filter(|(u, z)| !u.is_nan() && z.is_nan()).count();
        Some(SweepDepth { depth, deviation, out_of_range })
    }

    /// The warning that unstated settings are uneven. `order` has the index of each frame among the frames that were
    /// passed.
    pub(super) fn uneven_warning(&self, settings: &[f64], order: &[usize]) -> Option<String> {
        let steps = || settings.windows(2).map(|p| p[1] - p[0]);
        if *self != Self::Counted || steps().all(|step| step == 1.0) {
            return None;
        }
        let all: Vec<String> = settings.iter().map(|p| format!("{}", (100.0 * p).round() / 100.0)).collect();
        let used = format!("positions are taken as {}; state them if that is wrong", all.join(","));
        // Steps that grow or shrink evenly are those of a motor, and need no confirmation.
        let bends = settings.windows(4).map(|p| (p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0]).abs());
        if bends.fold(0.0, f64::max) < MOST_BEND {
            return None;
        }
        if steps().any(|step| step.fract() != 0.0) {
            return Some(format!("the frames seem to be focused at steps that are uneven in 1/distance: {used}"));
        }
        let gap = |(n, step): (usize, f64)| {
            let missing = if step == 2.0 { "a frame".to_string() } else { format!("{} frames", step - 1.0) };
            format!("{missing} between frames {} and {}", order[n] + 1, order[n + 1] + 1)
        };
        let gaps: Vec<String> = steps().enumerate().filter(|(_, step)| *step > 1.0).map(gap).collect();
        Some(format!("frames seem to be missing: {}; {used}", gaps.join(", ")))
    }
}

/// The distance in mm of a setting in 1/m, and its standard deviation: half the difference between the distances one
/// standard deviation to either side, as in [`BlurToDepth::sigma`](crate::metric::BlurToDepth::sigma). NaN if no
/// distance has this setting.
fn distance(u: f64, sigma: f64) -> (f32, f32) {
    let of = |u: f64| if u > 0.0 { PER_METRE / u } else { f64::INFINITY };
    if u.is_nan() || u <= 0.0 {
        return (f32::NAN, f32::NAN);
    }
    (of(u) as f32, ((of(u - sigma) - of(u + sigma)) / 2.0) as f32)
}

/// Depth in mm at each pixel of the reference of a sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepDepth {
    /// Depth, mm, from the lens, or along the axis from the origin of the stage; NaN where it is not measured.
    pub depth: Vec<f32>,
    /// The standard deviation of depth, mm; infinite where infinity is within one standard deviation. It excludes
    /// errors of the positions.
    pub deviation: Vec<f32>,
    /// The number of pixels with a setting beyond infinity; they have no depth.
    pub out_of_range: usize,
}

impl Positions {
    /// Depth of a sweep that was solved with the focus settings `solved`, if its frames are focused at these positions.
    /// `None` if the positions are not in mm.
    ///
    /// Between two frames, settings are interpolated linearly: in 1/mm for distances, in mm for a stage. Beyond the
    /// ends they are extrapolated.
    ///
    /// # Errors
    /// As for [`Positions::check`].
    pub fn depth_of(&self, solved: &[f64], focus: &[f32], uncertainty: &[f32]) -> Result<Option<SweepDepth>, Error> {
        self.check(solved.len())?;
        let map = PiecewiseLinear { from: solved, to: &self.settings(solved.len()) };
        let (focus, uncertainty): (Vec<f32>, Vec<f32>) =
            focus.iter().zip(uncertainty).map(|(&u, &sigma)| map.apply(u, sigma)).unzip();
        Ok(self.depth(&focus, &uncertainty))
    }
}

/// A piecewise linear map from the settings of three or more frames, in order, to other settings of the same frames.
struct PiecewiseLinear<'a> {
    from: &'a [f64],
    to: &'a [f64],
}

impl PiecewiseLinear<'_> {
    /// Maps a setting and its standard deviation.
    fn apply(&self, u: f32, sigma: f32) -> (f32, f32) {
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
    fn distances_are_inverse_settings_with_a_standard_deviation() {
        let at = Positions::Distances(vec![200.0, 250.0, 400.0]);
        at.check(3).unwrap();
        assert_eq!(at.settings(3), [5.0, 4.0, 2.5]);
        assert_eq!(at.first_is_nearest(), Some(true));
        let depth = at.depth(&[5.0, 2.5, f32::NAN, -0.1, 0.1], &[0.01, 0.01, f32::NAN, 0.1, 0.2]).unwrap();
        assert_eq!(depth.depth[..2], [200.0, 400.0]);
        // z² σ / 1000.
        assert!((depth.deviation[0] - 0.4).abs() < 1e-3 && (depth.deviation[1] - 1.6).abs() < 1e-3);
        assert!(depth.depth[2].is_nan() && depth.depth[3].is_nan() && depth.deviation[3].is_nan());
        assert_eq!((depth.out_of_range, depth.deviation[4]), (1, f32::INFINITY));
    }

    #[test]
    fn stage_positions_are_depths_and_settings_have_none() {
        let stage = Positions::Stage(vec![0.3, 0.1, -0.1]);
        assert_eq!((stage.settings(3), stage.first_is_nearest()), (vec![0.3, 0.1, -0.1], Some(false)));
        let depth = stage.depth(&[0.2, f32::NAN], &[0.01, f32::NAN]).unwrap();
        assert_eq!((depth.depth[0], depth.deviation[0], depth.out_of_range), (0.2, 0.01, 0));
        assert_eq!(Positions::Counted.depth(&[0.2], &[0.1]), None);
    }

    #[test]
    fn uneven_settings_give_a_warning() {
        let warning = |settings: &[f64]| Positions::Counted.uneven_warning(settings, &[0, 1, 3, 2, 4]);
        assert_eq!(warning(&[0.0, 1.0, 2.0, 3.0, 4.0]), None);
        let gaps = warning(&[0.0, 1.0, 3.0, 6.0, 7.0]).unwrap();
        assert!(gaps.contains("a frame between frames 2 and 4, 2 frames between frames 4 and 3"), "{gaps}");
        assert!(gaps.contains("positions are taken as 0,1,3,6,7;"), "{gaps}");
        let uneven = warning(&[0.0, 0.511, 1.0, 2.6, 4.0]).unwrap();
        assert!(uneven.contains("uneven in 1/distance") && uneven.contains("0,0.51,1,2.6,4"), "{uneven}");
        assert_eq!(warning(&[0.0, 0.75, 1.58, 2.49, 3.48, 4.55, 5.7, 7.0]), None);
        assert_eq!(Positions::Settings(vec![0.0, 2.0, 3.0]).uneven_warning(&[0.0, 2.0, 3.0], &[0, 1, 2]), None);
    }

    #[test]
    fn positions_that_do_not_fit_are_refused() {
        let refused = |positions: Positions| positions.check(3).unwrap_err().to_string();
        assert!(refused(Positions::Settings(vec![0.0, 1.0])).contains("2 positions for 3 frames"));
        for bad in [[0.0, 2.0, 1.0], [1.0, 1.0, 2.0], [0.0, f64::NAN, 1.0], [0.0, 1.0, f64::INFINITY]] {
            assert!(refused(Positions::Stage(bad.to_vec())).contains("ascending"));
        }
        assert!(refused(Positions::Distances(vec![100.0, 0.0, -1.0])).contains("0 mm"));
        assert!(Positions::Counted.check(3).is_ok());
    }

    #[test]
    fn settings_are_interpolated_between_frames_and_extrapolated_beyond() {
        let (up, down) = ([0.0, 1.0, 2.0], [2.0, 1.0, 0.0]);
        let map = PiecewiseLinear { from: &up, to: &[10.0, 8.0, 4.0] };
        let mapped = [-0.5, 0.0, 0.5, 1.0, 1.5, 2.5].map(|u| map.apply(u, 0.1));
        assert_eq!(mapped.map(|f| f.0), [11.0, 10.0, 9.0, 8.0, 6.0, 2.0]);
        assert_eq!(mapped.map(|f| f.1), [0.2, 0.2, 0.2, 0.2, 0.4, 0.4]);
        assert!(map.apply(f32::NAN, f32::NAN).0.is_nan());
        let map = PiecewiseLinear { from: &down, to: &up };
        assert_eq!([2.5, 1.5, -1.0].map(|u| map.apply(u, 0.0).0), [-0.5, 0.5, 3.0]);
    }
}
