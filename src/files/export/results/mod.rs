//! Results of a pair or a focus sweep, in memory or in a folder.

mod contents;
mod depth;
mod quantities;
mod read;

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::OnceLock;

use super::fused::Fused;
use super::report::{Report, TextureReport};
use crate::base::{Channels, Depth, Error};
use crate::engine::Solution;
use crate::solve::sweep::Sweep;

pub(super) use contents::NewFile;
pub use contents::{DEPTH_FILE, DEPTH_PICTURE_FILE, Drawing, Extra, PAGE_FILE, Plotter};

/// Results of a pair or a focus sweep: the report, and fields of one size.
///
/// ```no_run
/// use std::path::Path;
///
/// use parfocal::export::Results;
///
/// let results = Results::read(Path::new("out"))?;
/// let sigma = results.field("uncertainty")?;
/// println!("{} of {} pixels, T {:?}", results.report.frames.len(), sigma.len(), results.report.frames[1].transform);
/// # Ok::<(), parfocal::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Results<'a> {
    /// The folder; empty for results that were not read.
    pub folder: PathBuf,
    /// The report of the results.
    pub report: Report,
    /// V of a pair, px², or the focus of a sweep.
    values: Cow<'a, [f32]>,
    /// Standard deviation of `values`.
    uncertainty: Cow<'a, [f32]>,
    /// For a pair: the confidence in V; empty if the results were read.
    confidence: &'a [f32],
    /// For a pair: the residual; empty if the results were read.
    residual: &'a [f32],
    /// Depth and its standard deviation, mm.
    pub(super) depth: Option<[Cow<'a, [f32]>; 2]>,
    /// Pixels without a measurement: they lack texture, or have no focus, and are filled in.
    pub(super) marked: Vec<bool>,
    /// [`Results::filled`], computed once.
    filled: OnceLock<Vec<f32>>,
    /// For a sweep: -1 and 1 where no frame is in focus, by side.
    pub(super) beyond: Cow<'a, [i8]>,
    /// For a sweep: the frame that supplies each pixel of the fused image; empty if the results were read.
    pub(super) frames: &'a [u16],
    /// The fused image; `None` if the results were read.
    pub(super) fused: Option<Fused<'a>>,
}

/// The stored value of white.
fn white_of(depth: Depth) -> f32 {
    match depth {
        Depth::U8 => 255.0,
        Depth::U16 => 65535.0,
        Depth::F32 => 1.0,
    }
}

impl<'a> Results<'a> {
    /// Results of a pair. Its photographs have these sample types.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if a field does not have the size that the solution states.
    pub fn of_pair(solution: &'a Solution, report: Report, depths: [Depth; 2]) -> Result<Self, Error> {
        let fields = [&solution.relative_blur[..], &solution.uncertainty];
        let results = Self::new(report, &depths, fields, (solution.fused_channels, &solution.fused))?;
        let results = Self { confidence: &solution.confidence, residual: &solution.residual, ..results };
        results.check_lengths(&["relative_blur", "uncertainty", "confidence", "residual"])
    }

    /// Results of a focus sweep. Its frames have this sample type.
    ///
    /// # Errors
    /// As for [`of_pair`](Self::of_pair).
    pub fn of_sweep(sweep: &'a Sweep, report: Report, depth: Depth) -> Result<Self, Error> {
        let fields = [&sweep.focus[..], &sweep.uncertainty];
        let results = Self::new(report, &[depth], fields, (sweep.fused_channels, &sweep.fused))?;
        let depth = sweep.depth.as_ref().map(|depth| [(&depth.depth[..]).into(), (&depth.deviation[..]).into()]);
        let results = Self { depth, beyond: (&sweep.beyond[..]).into(), frames: &sweep.frames, ..results };
        results.check_lengths(&["focus", "uncertainty"])
    }

    /// Results with this quantity, its standard deviation and this fused image, of photographs with these sample types.
    fn new(
        mut report: Report,
        depths: &[Depth],
        [values, uncertainty]: [&'a [f32]; 2],
        fused: (Channels, &'a [f32]),
    ) -> Result<Self, Error> {
        let decode = report.values.decode.resolved(depths.iter().copied());
        report.values.decode = decode;
        let deepest = [Depth::F32, Depth::U16].into_iter().find(|depth| depths.contains(depth));
        let mut results = Self::empty(PathBuf::new(), report);
        let deepest = deepest.unwrap_or(Depth::U8);
        let fused = Fused::new(results.size(), fused, decode, deepest)?;
        results.report.tone = fused.tone.changing().map(|tone| tone.times(white_of(deepest)));
        results.fused = Some(fused);
        (results.values, results.uncertainty) = (values.into(), uncertainty.into());
        results.mark();
        Ok(results)
    }

    /// Checks that these fields have a value for each pixel.
    fn check_lengths(self, names: &[&str]) -> Result<Self, Error> {
        let (width, height) = self.size();
        let length = |name: &&str| self.in_memory(name).len();
        match names.iter().find(|name| length(name) != width as usize * height as usize) {
            None => Ok(self),
            Some(name) => {
                let problem = format!("{name} has {} values and the results are {width}x{height}", length(name));
                Err(Error::Mismatch(problem))
            }
        }
    }

    /// A field of this name; empty if it is not in memory.
    fn in_memory(&self, name: &str) -> &[f32] {
        match name {
            "uncertainty" => &self.uncertainty,
            "confidence" => self.confidence,
            "residual" => self.residual,
            "depth" => self.depth.as_ref().map_or(&[], |[depth, _]| depth),
            name if name == self.report.kind.quantity() => &self.values,
            _ => &[],
        }
    }

    /// Results without fields.
    fn empty(folder: PathBuf, report: Report) -> Self {
        Self {
            folder,
            report,
            values: Cow::default(),
            uncertainty: Cow::default(),
            confidence: &[],
            residual: &[],
            depth: None,
            marked: Vec::new(),
            filled: OnceLock::new(),
            beyond: Cow::default(),
            frames: &[],
            fused: None,
        }
    }

    /// Marks the pixels without a measurement.
    fn mark(&mut self) {
        self.marked = match &self.report.texture {
            Some(texture) => texture.marked(&self.uncertainty_without_scale()),
            None => self.values().iter().map(|value| value.is_nan()).collect(),
        };
        self.filled = OnceLock::new();
    }

    /// Width and height, px.
    pub fn size(&self) -> (u32, u32) {
        (self.report.size.width, self.report.size.height)
    }

    /// Scale of the second photograph of a pair relative to the first.
    pub fn magnification(&self) -> f64 {
        self.report.frames.get(1).map_or(1.0, |frame| frame.transform.scale())
    }

    /// Sets the standard deviation of V without that of its scale, px², above which a pixel is marked as lacking
    /// texture.
    pub fn set_max_uncertainty(&mut self, limit: f32) {
        self.report.texture = Some(TextureReport::beyond(limit, &self.uncertainty_without_scale()));
        self.mark();
    }
}
