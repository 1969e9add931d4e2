//! The parameters that all pixels of a sweep share, and the push constants that they make.

use super::pairs::{self, MAX_RELATIVE_BLUR};
use super::start::NOISE_CORRELATION;
use super::validity::{self, Rectangle};
use crate::base::{Homography, Photometric, Shading};
use crate::engine::plan::Level;
use crate::engine::script::sweep::{self, RegistrationStep};
use crate::engine::stages::state::Registration;
use crate::engine::stages::{align, half_pair, system, update};
use crate::engine::tiles::Ranges;

/// The largest blur of the sharper frame of a pair that counts, px² of a level, unless no frame is sharper. More
/// blurred frames say little, and a blur stack is made only where one is needed.
const MAX_SHARPER_BLUR: f64 = 1.0;
/// α of one pair.
const ALPHA: f64 = 0.005;
/// η of the data term: frames are band-passed, and vary less than photographs do.
const ETA: f64 = 0.005;
/// η of the smoothness term, px of blur per pixel.
const SMOOTHNESS_ETA: f64 = 0.1;
/// The largest step of u, px of blur.
const MAX_STEP: f64 = 0.3;
/// How far beyond the first and the last frame u may lie, px of blur.
const FOCUS_MARGIN: f64 = 0.5;

/// Iterations on the first level, on those between, and on the finest, where a second one takes as long as all before
/// it. It is left out if frames are as far apart as pairs are wide. With two, 41 frames of three generated stacks err
/// by 0.050, 0.032 and 0.041 of a frame instead of 0.057, 0.032 and 0.044, but 11 frames by 0.082 instead of 0.076. T
/// and c stay on the finest level: frames far out of focus show little but noise there. With steps of T a corner of the
/// last of 11 simulated frames is off by 0.07 px, without by 0.008.
pub(super) const ITERATIONS: [usize; 3] = [4, 3, 2];

/// The parameters that all pixels share.
#[derive(Clone)]
pub(super) struct SharedParameters {
    /// The focus settings of the frames, ascending.
    pub(super) settings: Vec<f64>,
    /// The middle between the first and the last. On the device u is relative to it.
    pub(super) middle: f64,
    pub(super) reference: usize,
    /// c, px² of the full-size image.
    pub(super) rate: f64,
    pub(super) transforms: Vec<Homography>,
    /// T as of the latest resampling of each frame; `None` on a level where it was not resampled yet.
    pub(super) resampled: Vec<Option<Homography>>,
    /// The parallax of each frame: what is in focus at u is displaced by u times this before T, px of the full-size image
    /// per setting. u is relative to the middle.
    pub(super) parallax: Vec<[f64; 2]>,
    /// Its standard deviation.
    pub(super) parallax_deviation: Vec<[f64; 2]>,
    /// The standard deviation that it adds to u, as a share of u: that of the size of all parallax, as far as displacement
    /// says what u is.
    pub(super) parallax_scale: f64,
    /// Gain and shading of each frame.
    pub(super) brightness: Vec<(f64, Shading)>,
    /// Pairs that contribute to a pixel, on average over those that count.
    pub(super) pairs_per_pixel: f64,
    /// The frames that do not lie on their neighbours.
    pub(super) unlike: Vec<usize>,
}

impl SharedParameters {
    /// c in px² of a level.
    pub(super) fn rate_on(&self, level: &Level) -> f64 {
        self.rate / (level.factor * level.factor)
    }

    /// The wider of the gaps between a frame's setting and its neighbours'.
    fn gap(&self, n: usize) -> f64 {
        let gap = |n: usize| self.settings.get(n + 1).map_or(0.0, |next| next - self.settings[n]);
        gap(n).max(if n > 0 { gap(n - 1) } else { 0.0 })
    }

    /// The parallax of a frame in pixels of a level per setting.
    fn parallax_on(&self, level: &Level, n: usize) -> [f64; 2] {
        self.parallax[n].map(|px| px / level.factor)
    }

    /// Whether parallax steps: if it was adopted, and with T.
    pub(super) fn steps_parallax(&self, registration: RegistrationStep) -> bool {
        registration == RegistrationStep::Free && self.parallax.iter().any(|moves| *moves != [0.0; 2])
    }

    /// Half the range of the settings.
    pub(super) fn half_range(&self) -> f64 {
        self.settings[self.settings.len() - 1] - self.middle
    }

    /// The largest |u| relative to the middle.
    pub(super) fn limit(&self, level: &Level) -> f64 {
        self.half_range() + FOCUS_MARGIN / self.rate_on(level).sqrt()
    }

    pub(super) fn finest_iterations(&self) -> usize {
        if pairs::stride(&self.settings, self.rate) < 2.0 { ITERATIONS[2] - 1 } else { ITERATIONS[2] }
    }

    /// Push constants that resample frame n onto the reference's pixels of a level.
    pub(super) fn alignment(&self, level: &Level, n: usize) -> align::Constants {
        let (gain, shading) = self.brightness[n];
        let registration = Registration::new(self.transforms[n], &Photometric { gain, offset: 0.0 });
        align::Constants {
            width: level.size[0],
            height: level.size[1],
            layer: n as u32,
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            registration: (&registration).into(),
            shading: shading.coefficients.map(|c| c as f32),
            parallax: self.parallax_on(level, n).map(|px| px as f32),
        }
    }

    /// All pairs by the sharper frame, for u in these ranges, and the frames of each pair in the order of the sums.
    /// `words`: the words per pixel that state which frames are excluded.
    pub(super) fn half_pairs(
        &self,
        level: &Level,
        words: u32,
        ranges: &Ranges,
        registration: RegistrationStep,
    ) -> (Vec<sweep::HalfPairs>, Vec<[usize; 2]>) {
        let rate = self.rate_on(level);
        let chosen = pairs::choose(&self.settings, rate);
        let [columns, rows, _] = half_pair::tiles(level.size);
        // By the sharper frame; either frame of a pair is the sharper one at some pixels.
        let (mut frames, mut half_pairs) = (Vec::new(), Vec::new());
        for sharper in 0..self.settings.len() {
            let partner = |[i, j]: &[usize; 2]| if *i == sharper { Some(*j) } else { (*j == sharper).then_some(*i) };
            let max_blur = MAX_SHARPER_BLUR.max(rate * self.gap(sharper).powi(2));
            let constants = chosen.iter().filter_map(partner).map(|other| {
                let row = half_pairs.len() as u32 * columns * rows;
                half_pairs.push([sharper, other]);
                half_pair::Constants { row, words, ..self.half_pair(level, max_blur, [sharper, other]) }
            });
            let others = constants.collect();
            let (setting, reach) = (self.settings[sharper] - self.middle, (max_blur / rate).sqrt());
            let needed = ranges.between(setting - reach, setting + reach);
            frames.push(sweep::HalfPairs { sharper: sharper as u32, others, of_parallax: Vec::new(), needed });
        }
        if self.steps_parallax(registration) {
            // Their sums follow those of all pairs.
            let (count, per_u) = (half_pairs.len() as u32 * columns * rows, (1.0 / self.half_range()) as f32);
            for pairs in &mut frames {
                let again = |c: &half_pair::Constants| half_pair::Constants { row: c.row + count, per_u, ..*c };
                pairs.of_parallax = pairs.others.iter().map(again).collect();
            }
        }
        (frames, half_pairs)
    }

    fn half_pair(&self, level: &Level, max_blur: f64, [sharper, other]: [usize; 2]) -> half_pair::Constants {
        let setting = |n: usize| (self.settings[n] - self.middle) as f32;
        let transform = |n: usize| self.resampled[n].unwrap_or(self.transforms[n]);
        let [own_moves, other_moves] = [sharper, other].map(|n| self.parallax_on(level, n));
        let visible: [Rectangle; 2] = [sharper, other].map(|n| validity::visible(&transform(n), level));
        // A frame shows what parallax displaces into it.
        let reach = [0, 1].map(|c| self.limit(level) * own_moves[c].abs().max(other_moves[c].abs()));
        let [left, top, right, bottom] = validity::intersection(visible);
        let shown = [left + reach[0], top + reach[1], right - reach[0], bottom - reach[1]];
        half_pair::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            other: other as u32,
            row: 0,
            listed: 0,
            own: sharper as u32,
            words: 0,
            own_setting: setting(sharper),
            other_setting: setting(other),
            rate: self.rate_on(level) as f32,
            grain: NOISE_CORRELATION as f32,
            eta: ETA as f32,
            limit: MAX_RELATIVE_BLUR.min(level.limit) as f32,
            far: max_blur as f32,
            length: level.length as f32,
            centre: level.centre.map(|c| c as f32),
            shown: shown.map(|side| side as f32),
            baseline: [0, 1].map(|c| (other_moves[c] - own_moves[c]) as f32),
            per_u: 0.0,
        }
    }

    /// Push constants of a step of u, with c of the level.
    pub(super) fn step(&self, level: &Level, rate: f64) -> (system::Constants, update::Constants) {
        let [width, height] = level.size;
        let system = system::Constants {
            width,
            height,
            alpha: (ALPHA * self.pairs_per_pixel) as f32,
            rate: rate as f32,
            smoothness_eta: SMOOTHNESS_ETA as f32,
        };
        let update = update::Constants {
            width,
            height,
            largest_step: (MAX_STEP / rate.sqrt()) as f32,
            relative_step: 0.0,
            limit: self.limit(level) as f32,
            share: 1.0,
            extrapolation: 0,
        };
        (system, update)
    }
}
