//! A focus sweep of a scene instead of a pair, with its truth.
//!
//! Frame k is focused at the setting p_k = k. A point in focus at u has in this frame the blur variance
//!
//! ```text
//! v_k = c (p_k - u)² + base blur        px² of the reference
//! ```
//!
//! The scene extends over a part of the range of settings. Each frame has its own displacement and
//! exposure. The middle frame is the reference, which has neither. u is stated on its pixels.

use std::f64::consts::TAU;

use super::layers::{Layer, Layered};
use super::radiance::Pattern;
use super::shape::{Surface, share_of};
use super::view::View;
use super::{Exposure, Scene, Shape, range};
use crate::base::random::Random;
use crate::base::{Error, Frame, Lens, Similarity, centre};

/// A description from which a focus sweep is rendered. [`SweepScene::new`] makes one with defaults.
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
    /// The scene. Its transform, exposure and blur limit apply to pairs and are ignored. Its camera moves from the first to
    /// the last frame.
    pub scene: Scene,
    /// Number of frames, 3 to 999.
    pub frames: usize,
    /// c, px² of variance per squared setting; above 0, at most 576.
    pub blur_rate: f64,
    /// Growth of the scene's size from the first to the last frame, relative to its size in the reference; -0.2 to 0.2.
    pub breathing: f64,
    /// Distance of the last frame from the first, px, on a path that sways to both sides; 0 to 1000.
    pub drift: f64,
    /// Rotation of the last frame relative to the first, radians; -0.5 to 0.5.
    pub rotation: f64,
    /// Largest difference of the gain from the reference's; -0.5 to 0.5. The gain increases linearly.
    pub gain_drift: f64,
    /// Darkening of the corners of the last frame relative to the reference's; -0.5 to 0.5. The corners of the first
    /// frame are brighter. The middle of each frame stays unchanged.
    pub vignetting: f64,
    /// The settings at which the two ends of the scene are in focus, as fractions of the range of settings; 0 to 1.
    pub span: [f64; 2],
}

/// The truth of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// The setting at which it is focused.
    pub position: f64,
    /// T: `I(T x)` corresponds to the reference at x.
    pub transform: Similarity,
    /// The exposure relative to the reference.
    pub exposure: Exposure,
    /// Darkening of the corners relative to the reference's, after the exposure is undone. It is proportional to the
    /// squared distance from the middle.
    pub vignetting: f64,
}

/// A rendered sweep, and the truth about it.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedSweep {
    /// The frames in order, in the same format as the frames of a pair.
    pub frames: Vec<Frame>,
    /// The truth of each frame.
    pub shots: Vec<Shot>,
    /// Index of the reference frame; `focus` is on its pixels.
    pub reference: usize,
    /// u at each pixel of the reference, row-major, in settings.
    pub focus: Vec<f32>,
}

/// Greatest number of frames: their names have three digits.
const MOST_FRAMES: usize = 999;
/// Greatest number of pixels of all frames: 1 GiB.
const MOST_PIXELS: f64 = (1u64 << 28) as f64;
/// Default blur at one end of a point in focus at the other end: σ, px.
const END: f64 = 6.0;
/// The default ends of the scene, as fractions of the range of settings.
const SPAN: [f64; 2] = [0.1, 0.9];
/// Sway of the drift path, as a fraction of its length.
const SWAY: f64 = 0.15;

impl SweepScene {
    /// Makes a sweep without displacement or change of brightness. A point in focus at one end of the settings has the
    /// blur σ 6 px at the other end.
    pub fn new(scene: Scene, frames: usize) -> Self {
        let blur_rate = (END / (frames.max(2) - 1) as f64).powi(2);
        let (breathing, drift, rotation, gain_drift, vignetting) = (0.0, 0.0, 0.0, 0.0, 0.0);
        Self { scene, frames, blur_rate, breathing, drift, rotation, gain_drift, vignetting, span: SPAN }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Setting`] with the first field that is out of range; [`Error::Mismatch`] if the scene has no depth, or
    /// if there are too many frames for their size; those of [`Scene::check`].
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
        range("vignetting", self.vignetting, -0.5, 0.5)?;
        self.span.iter().try_for_each(|end| range("end of the scene", *end, 0.0, 1.0))
    }

    /// The index of the reference frame: the middle one.
    pub fn reference(&self) -> usize {
        self.frames / 2
    }

    /// The truth of each frame.
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
            // The reference is in the middle, or half a step before it, so the value is at most 1 on either side.
            let aside = (k - reference) / reference;
            let exposure = Exposure { gain: 1.0 + self.gain_drift * aside, offset: 0.0 };
            Shot { position: k, transform, exposure, vignetting: self.vignetting * aside }
        };
        (0..self.frames).map(|k| of(k as f64)).collect()
    }

    /// Renders the frames. Each takes the time of one image of a pair.
    ///
    /// # Errors
    /// As [`check`](Self::check) and [`Scene::render`].
    pub fn render(&self) -> Result<SimulatedSweep, Error> {
        self.check()?;
        let Scene { width, height, seed, transform, .. } = self.scene;
        let surface = self.scene.shape.surface([width, height], seed, transform.scale)?;
        let shots = self.shots();
        let content = self.content(&shots)?;
        let frame = |k: usize| {
            let shot = &shots[k];
            self.scene.expose(k, shot.exposure, self.light(shot), &self.planes(shot, &content, &surface)?)
        };
        let frames = (0..self.frames).map(frame).collect::<Result<_, _>>()?;
        let width = self.scene.width as usize;
        let place = |i: usize| [(i % width) as f64, (i / width) as f64];
        let focus = (0..width * self.scene.height as usize).map(|i| self.setting(surface(place(i)).share) as f32);
        Ok(SimulatedSweep { frames, focus: focus.collect(), reference: self.reference(), shots })
    }

    /// The setting at which a point is in focus, for a share of the way between the ends of the scene.
    fn setting(&self, share: f64) -> f64 {
        let [first, last] = self.span;
        (first + (last - first) * share) * (self.frames - 1) as f64
    }

    /// Prepares the content of all frames.
    fn content(&self, shots: &[Shot]) -> Result<Content, Error> {
        let scene = &self.scene;
        let Shape::Layers { arrangement, lens } = &scene.shape else {
            return Ok(Content::Surface(scene.radiance.channels([scene.width, scene.height], scene.seed)?));
        };
        let layers = arrangement.layers(scene.seed, [scene.width, scene.height], lens);
        let focus = self.focus_of(&layers, lens);
        let all: Vec<f64> = shots.iter().flat_map(|shot| self.deviations(shot, &focus)).collect();
        let layered = Box::new(scene.layered(layers, all.iter())?);
        Ok(Content::Layers { layered, focus, lens: Box::new(*lens) })
    }

    fn focus_of(&self, layers: &[Layer], lens: &Lens) -> Vec<f64> {
        layers.iter().map(|layer| self.setting(share_of(lens, layer.depth))).collect()
    }

    /// Standard deviation of the blur on a frame's sensor of points in focus at these settings, px. Negative beyond the
    /// focus, where the cone of rays is inverted.
    fn deviations(&self, shot: &Shot, focus: &[f64]) -> Vec<f64> {
        let over = shot.transform.scale * self.blur_rate.sqrt();
        focus.iter().map(|u| over * (shot.position - u)).collect()
    }

    /// The fraction of light that vignetting leaves at each pixel of a frame.
    fn light(&self, shot: &Shot) -> impl Fn(usize) -> f64 + use<> {
        let (width, amount) = (self.scene.width as usize, shot.vignetting);
        let [x, y] = centre(self.scene.width, self.scene.height);
        let squared = move |i: usize| ((i % width) as f64 - x).powi(2) + ((i / width) as f64 - y).powi(2);
        move |i| 1.0 - amount * squared(i) / squared(0)
    }

    /// The channels of one frame.
    fn planes(&self, shot: &Shot, content: &Content, surface: &Surface) -> Result<Vec<Vec<f64>>, Error> {
        let view = View::new(&shot.transform, [self.scene.width, self.scene.height]);
        match content {
            Content::Surface(channels) => {
                let variance = |x| self.blur_rate * (shot.position - self.setting(surface(x).share)).powi(2);
                self.scene.gathered(&view, variance, channels)
            }
            Content::Layers { layered, focus, lens } => {
                let share = (shot.position - self.reference() as f64) / (self.frames - 1) as f64;
                let moved = layered.changed(|layers| self.scene.displace(layers, lens, share));
                Ok(vec![moved.image(&view, &self.deviations(shot, focus))])
            }
        }
    }
}

/// The content of all frames of a sweep, ready to be rendered.
enum Content {
    /// The channels of the radiance, on one surface.
    Surface(Vec<Pattern>),
    /// Layers, the setting at which each is in focus, and the lens that their depths are stated for.
    Layers { layered: Box<Layered>, focus: Vec<f64>, lens: Box<Lens> },
}

/// The displacement along the drift path at a time from 0 to 1.
fn path(time: f64, drift: f64, direction: f64) -> [f64; 2] {
    let (along, across) = (drift * time, SWAY * drift * (TAU * time).sin());
    let (sin, cos) = direction.sin_cos();
    [along * cos - across * sin, along * sin + across * cos]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::scene::files::floats;
    use crate::lab::scene::{Kernel, Preset};

    const SIZE: [u32; 2] = [70, 40];

    /// Renders eleven frames. The surface of a scene, with shares 0 to 1 between its ends, is in focus at settings 1 to
    /// 9.
    fn eleven(preset: Preset) -> SweepScene {
        let scene = Scene { width: SIZE[0], height: SIZE[1], noise: 0.0, ..preset.scene() };
        SweepScene::new(scene, 11)
    }

    /// Renders the second image of a pair with the same texture, with uniform blur and the transform T.
    fn under(sweep: &SweepScene, variance: f64, transform: Similarity, exposure: Exposure) -> Frame {
        let shape = Shape::Uniform { variance };
        Scene { shape, transform, exposure, ..sweep.scene.clone() }.render().unwrap().i2
    }

    fn worst(a: &Frame, b: &Frame, counts: impl Fn(usize) -> bool) -> f32 {
        let pairs = floats(a).iter().zip(floats(b)).enumerate().filter(|(i, _)| counts(*i));
        pairs.map(|(_, (a, b))| (a - b).abs()).fold(0.0, f32::max)
    }

    /// The first terrace is in focus at 1, the last at 9.
    #[test]
    fn each_terrace_is_sharp_in_its_frame_and_follows_the_blur_law_in_others() {
        let sweep = eleven(Preset::Steps);
        let found = sweep.render().unwrap();
        for (terrace, u) in [(0, 1.0), (6, 9.0)] {
            let within = |i: usize| i % 70 / 10 == terrace;
            assert!((0..70 * 40).filter(|i| within(*i)).all(|i| (f64::from(found.focus[i]) - u).abs() < 1e-6));
            for (k, frame) in found.frames.iter().enumerate() {
                let variance = sweep.blur_rate * (k as f64 - u).powi(2);
                let expected = under(&sweep, variance, Similarity::IDENTITY, Exposure::default());
                assert!(worst(frame, &expected, within) < 1e-6, "terrace {terrace}, frame {k}");
            }
        }
    }

    /// Without blur, every frame is the second image of a pair with the frame's T and exposure.
    #[test]
    fn frames_have_the_transform_and_exposure_of_the_truth() {
        let moved =
            SweepScene { breathing: 0.06, drift: 8.0, rotation: 0.02, gain_drift: 0.05, ..eleven(Preset::Plane) };
        let sweep = SweepScene { blur_rate: 1e-9, ..moved };
        let found = sweep.render().unwrap();
        assert_eq!((found.reference, found.shots[5].transform), (5, Similarity::IDENTITY));
        for (frame, shot) in found.frames.iter().zip(&found.shots) {
            let expected = under(&sweep, 0.0, shot.transform, shot.exposure);
            assert!(worst(frame, &expected, |_| true) < 1e-6, "frame {}", shot.position);
        }
        let (first, last) = (&found.shots[0], &found.shots[10]);
        let (a, b) = (first.transform, last.transform);
        assert!((b.scale - a.scale - 0.06).abs() < 1e-12 && (b.rotation - a.rotation - 0.02).abs() < 1e-12);
        assert!(((b.tx - a.tx).hypot(b.ty - a.ty) - 8.0).abs() < 1e-12);
        assert!((first.exposure.gain - 0.95).abs() < 1e-12 && (last.exposure.gain - 1.05).abs() < 1e-12);
        // The path is smooth: no step is much longer than the mean.
        let step = |s: &[Shot]| (s[1].transform.tx - s[0].transform.tx).hypot(s[1].transform.ty - s[0].transform.ty);
        assert!(found.shots.windows(2).all(|s| step(s) < 1.4 * 0.8), "{:?}", found.shots);
    }

    /// With the blur rate of the lens, the frames at the settings of the scene's ends equal the images of the pair,
    /// including occlusion.
    #[test]
    fn the_ends_of_a_scene_with_a_lens_are_its_pair() {
        for (preset, kernel) in [(Preset::Cylinders, Kernel::Gaussian), (Preset::Blocks, Kernel::Pillbox)] {
            let mut sweep = eleven(preset);
            sweep.scene.kernel = kernel;
            sweep.scene.transform = Similarity::IDENTITY;
            let lens = *sweep.scene.lens().unwrap();
            // I1 is focused at setting 1, and I2 eight settings further.
            sweep.blur_rate = lens.variance(0, lens.focus[1]) / 64.0;
            let (found, pair) = (sweep.render().unwrap(), sweep.scene.render().unwrap());
            let off = worst(&found.frames[1], &pair.i1, |_| true);
            assert!(off < 1e-6, "{}: {off}", sweep.scene.name);
            for (u, z) in found.focus.iter().zip(pair.depth.unwrap()) {
                let expected = lens.variance(0, z.into()) / sweep.blur_rate;
                assert!(((f64::from(*u) - 1.0).powi(2) - expected).abs() < 1e-3, "{u} at {z} mm");
            }
        }
    }

    /// The brightness of the reference's pixels in other frames: corners are darker towards the last frame and brighter
    /// towards the first.
    #[test]
    fn corners_darken_from_frame_to_frame() {
        let even = SweepScene { blur_rate: 1e-9, ..eleven(Preset::Plane) };
        let (found, plain) =
            (SweepScene { vignetting: 0.06, ..even.clone() }.render().unwrap(), even.render().unwrap());
        assert_eq!(found.frames[5], plain.frames[5]);
        for (k, corner) in [(0, 1.06), (10, 0.94)] {
            let factor = |i: usize| floats(&found.frames[k])[i] / floats(&plain.frames[k])[i];
            assert!((factor(0) - corner).abs() < 1e-6 && (factor(70 * 40 - 1) - corner).abs() < 1e-6, "frame {k}");
            // Half-way to the corner the effect is a quarter.
            assert!(((factor(10 * 70 + 17) - 1.0) / (corner - 1.0) - 0.25).abs() < 0.02, "frame {k}");
        }
    }

    #[test]
    fn the_seed_determines_all_and_every_frame_has_its_own_noise() {
        let mut sweep = SweepScene { drift: 3.0, ..eleven(Preset::Relief) };
        let clean = sweep.render().unwrap();
        sweep.scene.noise = 0.01;
        let found = sweep.render().unwrap();
        assert_eq!(found, sweep.render().unwrap());
        let noise = |k: usize| floats(&found.frames[k]).iter().zip(floats(&clean.frames[k])).map(|(a, b)| a - b);
        let product = |i, j| noise(i).zip(noise(j)).map(|(a, b)| f64::from(a * b)).sum::<f64>() / 2800.0;
        assert!((product(3, 3).sqrt() / 0.01 - 1.0).abs() < 0.1 && product(3, 4).abs() < 1e-5);
        sweep.scene.seed = 2;
        assert!(sweep.render().unwrap().shots[0] != found.shots[0]);
    }

    #[test]
    fn an_error_names_the_field_that_is_out_of_range() {
        let plane = || eleven(Preset::Plane);
        let huge = Scene { width: 4096, height: 4096, ..Preset::Plane.scene() };
        for (sweep, part) in [
            (SweepScene { frames: 2, ..plane() }, "number of frames is 2"),
            (SweepScene { frames: 1000, ..plane() }, "number of frames"),
            (SweepScene::new(huge, 40), "pixels of all frames"),
            (SweepScene { blur_rate: 0.0, ..plane() }, "blur rate"),
            (SweepScene { blur_rate: 100.0, ..plane() }, "largest variance"),
            (SweepScene { blur_rate: 100.0, ..eleven(Preset::Bars) }, "largest variance"),
            (SweepScene { breathing: 0.3, ..plane() }, "breathing"),
            (SweepScene { drift: f64::NAN, ..plane() }, "drift"),
            (SweepScene { gain_drift: 1.0, ..plane() }, "gain drift"),
            (SweepScene { vignetting: -0.6, ..plane() }, "vignetting"),
            (eleven(Preset::HalfGaussianDots), "no depth to sweep through"),
        ] {
            let problem = sweep.render().unwrap_err().to_string();
            assert!(problem.contains(part), "{problem}");
        }
    }
}
