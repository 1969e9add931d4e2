//! A focus sweep of a scene instead of a pair, with its truth.
//!
//! Frame k is focused at the setting p_k = k. A point in focus at u is blurred in it by
//!
//! ```text
//! v_k = c (p_k - u)² + base blur        px² of the reference
//! ```
//!
//! and the scene lies between a tenth and nine tenths of the settings. Frames are displaced and exposed each in its own
//! way; the middle one is the reference, on whose pixels u is stated, and is neither.

mod files;
#[cfg(test)]
mod tests;

use std::f64::consts::TAU;

pub use files::{SweepTruth, simulated_sweep_files, write_simulated_sweep};

use super::layers::Layer;
use super::occlusion::Layered;
use super::radiance::Pattern;
use super::shape::{Surface, share_of};
use super::view::View;
use super::{Exposure, Scene, Shape, range};
use crate::base::random::Random;
use crate::base::{Error, Frame, Lens, Similarity, centre};

/// A description from which a focus sweep is rendered; [`SweepScene::new`] gives one to change.
///
/// ```
/// use parfocal::internals::scene::{Preset, Scene, SweepScene};
///
/// # fn main() -> Result<(), parfocal::Error> {
/// let scene = Scene { width: 48, height: 32, ..Preset::Relief.scene() };
/// let sweep = SweepScene { drift: 3.0, ..SweepScene::new(scene, 5) }.render()?;
/// println!("the first pixel is in focus at {}, of settings 0 to 4", sweep.focus[0]);
/// # assert_eq!((sweep.frames.len(), sweep.reference), (5, 2));
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SweepScene {
    /// What is seen. Its transform, its exposure and the limit of its blur are those of a pair, and play no part.
    pub scene: Scene,
    /// How many frames, 3 to 999.
    pub frames: usize,
    /// c, px² of variance a squared setting; above 0, at most 576.
    pub blur_rate: f64,
    /// How much larger the last frame shows the scene than the first, of the reference's size; -0.2 to 0.2.
    pub breathing: f64,
    /// How far the last frame is from the first, px, on a path that sways to either side; 0 to 1000.
    pub drift: f64,
    /// By how much the last frame is turned against the first, radians; -0.5 to 0.5.
    pub rotation: f64,
    /// The gain rises evenly, by at most this above or below that of the reference; -0.5 to 0.5.
    pub gain_drift: f64,
    /// The corners of the last frame are by this darker than the reference's, those of the first brighter, evenly between; the middle of a
    /// frame is not. -0.5 to 0.5.
    pub vignetting: f64,
}

/// What is true of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// The setting at which it is focused.
    pub position: f64,
    /// T: `I(T x)` lies over the reference at x.
    pub transform: Similarity,
    /// How it was exposed against the reference.
    pub exposure: Exposure,
    /// By how much its corners are darker than the reference's, once the exposure is undone; less by the squared distance from the middle.
    pub vignetting: f64,
}

/// A rendered sweep, and the truth about it.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedSweep {
    /// The frames in order, as those of a pair.
    pub frames: Vec<Frame>,
    /// What is true of each.
    pub shots: Vec<Shot>,
    /// The frame on whose pixels `focus` is, from 0.
    pub reference: usize,
    /// u at each pixel of the reference, row-major, in settings.
    pub focus: Vec<f32>,
}

/// Most frames: their names have three digits.
const MOST_FRAMES: usize = 999;
/// Most pixels of all frames: 1 GiB.
const MOST_PIXELS: f64 = (1u64 << 28) as f64;
/// Blur at one end of what is in focus at the other, unless a rate is stated: σ, px.
const END: f64 = 6.0;
/// What a scene spans of the settings.
const SPAN: [f64; 2] = [0.1, 0.9];
/// How far the path of the drift sways, of its length.
const SWAY: f64 = 0.15;

impl SweepScene {
    /// A sweep of so many frames that nothing moves and nothing brightens. What is in focus at one end of the settings is
    /// blurred by σ 6 px at the other.
    pub fn new(scene: Scene, frames: usize) -> Self {
        let blur_rate = (END / (frames.max(2) - 1) as f64).powi(2);
        Self { scene, frames, blur_rate, breathing: 0.0, drift: 0.0, rotation: 0.0, gain_drift: 0.0, vignetting: 0.0 }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Setting`] with the first field that is out of range; [`Error::Mismatch`] where the scene has no depth, or
    /// the frames are too many for their size; those of [`Scene::check`].
    pub fn check(&self) -> Result<(), Error> {
        self.scene.check()?;
        let pixels = f64::from(self.scene.width) * f64::from(self.scene.height);
        range("number of frames", self.frames as f64, 3.0, MOST_FRAMES as f64)?;
        if matches!(self.scene.shape, Shape::Uniform { .. }) {
            let problem = format!("{} has no depth to sweep through; take a scene that has", self.scene.name);
            return Err(Error::Mismatch(problem));
        }
        range("number of pixels of all frames", self.frames as f64 * pixels, 0.0, MOST_PIXELS)?;
        range("blur rate", self.blur_rate, 1e-9, super::MOST_VARIANCE)?;
        range("breathing", self.breathing, -0.2, 0.2)?;
        range("drift", self.drift, 0.0, 1000.0)?;
        range("rotation over the sweep", self.rotation, -0.5, 0.5)?;
        range("gain drift", self.gain_drift, -0.5, 0.5)?;
        range("vignetting", self.vignetting, -0.5, 0.5)
    }

    /// The frame on whose pixels the truth is: the middle one.
    pub fn reference(&self) -> usize {
        self.frames / 2
    }

    /// What is true of each frame.
    pub fn shots(&self) -> Vec<Shot> {
        let (last, reference) = ((self.frames - 1) as f64, self.reference() as f64);
        let direction = TAU * Random::new(self.scene.seed, 5).uniform();
        let place = |k: f64| path(k / last, self.drift, direction);
        let [x, y] = place(reference);
        let of = |k: f64| {
            let over = (k - reference) / last;
            let (scale, rotation) = (1.0 + self.breathing * over, self.rotation * over);
            let [tx, ty] = place(k);
            let transform = Similarity { tx: tx - x, ty: ty - y, rotation, scale };
            // The reference is in the middle, or half a step behind it: at most 1 on either side.
            let aside = (k - reference) / reference;
            let exposure = Exposure { gain: 1.0 + self.gain_drift * aside, offset: 0.0 };
            Shot { position: k, transform, exposure, vignetting: self.vignetting * aside }
        };
        (0..self.frames).map(|k| of(k as f64)).collect()
    }

    /// Renders the frames, each of them in the time of one image of a pair.
    ///
    /// # Errors
    /// Those of [`check`](Self::check) and of [`Scene::render`].
    pub fn render(&self) -> Result<SimulatedSweep, Error> {
        self.check()?;
        let surface = self.scene.shape.surface(&self.scene)?;
        let shots = self.shots();
        let seen = self.seen(&shots)?;
        let frame = |k: usize| {
            let shot = &shots[k];
            self.scene.expose(k, shot.exposure, self.light(shot), &self.planes(shot, &seen, &surface)?)
        };
        let frames = (0..self.frames).map(frame).collect::<Result<_, _>>()?;
        let width = self.scene.width as usize;
        let place = |i: usize| [(i % width) as f64, (i / width) as f64];
        let focus = (0..width * self.scene.height as usize).map(|i| self.setting(surface(place(i)).share) as f32);
        Ok(SimulatedSweep { frames, focus: focus.collect(), reference: self.reference(), shots })
    }

    /// The setting at which a share of the way between the ends of the scene is in focus.
    fn setting(&self, share: f64) -> f64 {
        (SPAN[0] + (SPAN[1] - SPAN[0]) * share) * (self.frames - 1) as f64
    }

    /// What all frames show.
    fn seen(&self, shots: &[Shot]) -> Result<Seen, Error> {
        let scene = &self.scene;
        let Shape::Layers { arrangement, lens } = &scene.shape else {
            return Ok(Seen::Surface(scene.radiance.channels(scene)?));
        };
        let layers = arrangement.layers(scene.seed, [scene.width, scene.height], lens);
        let focus = self.focus_of(&layers, lens);
        let all: Vec<f64> = shots.iter().flat_map(|shot| self.deviations(shot, &focus)).collect();
        Ok(Seen::Layers(scene.layered(layers, all.iter())?, focus))
    }

    fn focus_of(&self, layers: &[Layer], lens: &Lens) -> Vec<f64> {
        layers.iter().map(|layer| self.setting(share_of(lens, layer.depth))).collect()
    }

    /// Of what is in focus at these settings, the deviation of a frame's blur on its sensor, px; negative beyond the focus,
    /// where the cone of rays opens the other way.
    fn deviations(&self, shot: &Shot, focus: &[f64]) -> Vec<f64> {
        let over = shot.transform.scale * self.blur_rate.sqrt();
        focus.iter().map(|u| over * (shot.position - u)).collect()
    }

    /// What vignetting leaves at each pixel of a frame.
    fn light(&self, shot: &Shot) -> impl Fn(usize) -> f64 + use<> {
        let (width, amount) = (self.scene.width as usize, shot.vignetting);
        let [x, y] = centre(self.scene.width, self.scene.height);
        let squared = move |i: usize| ((i % width) as f64 - x).powi(2) + ((i / width) as f64 - y).powi(2);
        move |i| 1.0 - amount * squared(i) / squared(0)
    }

    /// The channels of one frame.
    fn planes(&self, shot: &Shot, seen: &Seen, surface: &Surface) -> Result<Vec<Vec<f64>>, Error> {
        let view = View::new(&shot.transform, [self.scene.width, self.scene.height]);
        match seen {
            Seen::Surface(channels) => {
                let variance = |x| self.blur_rate * (shot.position - self.setting(surface(x).share)).powi(2);
                self.scene.gathered(&view, variance, channels)
            }
            Seen::Layers(layered, focus) => Ok(vec![layered.image(&view, &self.deviations(shot, focus))]),
        }
    }
}

/// What all frames of a sweep show, made ready.
enum Seen {
    /// The channels of the radiance, on one surface.
    Surface(Vec<Pattern>),
    /// Layers, and the setting at which each is in focus.
    Layers(Layered, Vec<f64>),
}

/// A place on the path of the drift, at a time from 0 to 1.
fn path(time: f64, drift: f64, direction: f64) -> [f64; 2] {
    let (along, across) = (drift * time, SWAY * drift * (TAU * time).sin());
    let (sin, cos) = direction.sin_cos();
    [along * cos - across * sin, along * sin + across * cos]
}
