//! Depth in mm, from a lens or from the positions of the frames.

use std::borrow::Cow;

use super::Results;
use crate::base::{Error, Lens, Region};
use crate::files::export::image_files::{Description, METRIC_DEPTH, SWEEP_DEPTH};
use crate::files::export::report::{DepthReport, NearerBy, SizeReport};
use crate::files::export::scale::{Nearer, Quantity};
use crate::metric::{DOUBT, MetricDepth};
use crate::solve::sweep::Positions;

impl Results<'_> {
    /// Depth in mm, if it is known.
    pub fn depth(&self) -> Option<Quantity<'_>> {
        let [values, deviation] = self.depth.as_ref()?;
        Some(match self.lens() {
            Some(lens) => Quantity::depth(values, deviation, &lens.focus, Nearer::Second),
            None => {
                let planes = self.planes();
                Quantity::depth(values, deviation, &planes, self.report.nearer().end_of(&planes))
            }
        })
    }

    /// The lens of a pair, if it is known.
    pub fn lens(&self) -> Option<&Lens> {
        self.report.depth.as_ref()?.lens.as_ref()
    }

    /// The size of a pixel on the surface, mm, if it is stated: the same everywhere.
    pub fn pixel_mm(&self) -> Option<f64> {
        self.report.pixel_size_um.map(|um| um / 1000.0)
    }

    /// The size of a pixel at the middle of the scale of [`best`](Self::best), mm: as stated, or by the lens. `None` if
    /// neither is known, or `best` is not in mm.
    pub fn footprint(&self) -> Option<f64> {
        let depth = self.best();
        let by_lens = || self.lens().map(|lens| lens.footprint(depth.scale().value(0.5)));
        (depth.unit == "mm").then(|| self.pixel_mm().or_else(by_lens)).flatten()
    }

    /// Focus settings of the frames of a sweep.
    pub(crate) fn positions(&self) -> Vec<f64> {
        self.report.frames.iter().filter_map(|frame| frame.position).collect()
    }

    /// Focus distances, or positions along the axis of a stage, of the frames of a sweep, mm, as far as they are
    /// stated.
    pub(super) fn planes(&self) -> Vec<f64> {
        self.report.frames.iter().filter_map(|frame| frame.focus_mm).collect()
    }

    /// Sets the lens of a pair, and from it depth and the nearer image. Returns a warning for each fact that
    /// contradicts the lens.
    pub fn set_lens(&mut self, lens: &Lens) -> Vec<String> {
        let (metric, blur) = self.depth_through(lens);
        let (scale, limit) = (self.magnification(), self.report.blur_limit());
        let doubts: Vec<String> = self.field_doubt(lens).into_iter().chain(metric.doubt(scale, limit, &blur)).collect();
        let depth = DepthReport::new(&metric.depth, &metric.deviation, metric.out_of_range);
        self.report.depth = Some(DepthReport { lens: Some(*lens), ..depth });
        self.report.nearer = Some(Nearer::of_lens(lens).number());
        self.report.nearer_by = Some(NearerBy::Lens);
        self.report.warnings.retain(|warning| !warning.starts_with(DOUBT));
        self.report.warnings.extend(doubts.iter().cloned());
        self.depth = Some([metric.depth.into(), metric.deviation.into()]);
        doubts
    }

    /// Returns depth through a lens, and V as it would be at the image centre.
    fn depth_through(&self, lens: &Lens) -> (MetricDepth, Cow<'_, [f32]>) {
        let (scale, limit, width) = (self.magnification(), self.report.blur_limit(), self.report.size.width);
        let [blur, deviation] = self.blur_at_centre(lens);
        (MetricDepth::new(lens, scale, limit, width, &blur, &deviation), blur)
    }

    /// V and its standard deviation, as they would be at the image centre, where the lens holds.
    fn blur_at_centre(&self, lens: &Lens) -> [Cow<'_, [f32]>; 2] {
        let fields = [self.values(), self.uncertainty()];
        match &lens.field {
            Some(field) if self.field_doubt(lens).is_none() => {
                let (Region { x, y, .. }, limit) = (self.report.region, self.report.blur_limit());
                field.to_centre(fields, self.report.size.width, [x, y], limit).map(Cow::from)
            }
            _ => fields.map(Cow::from),
        }
    }

    /// Why the field of a lens does not apply, if it does not.
    fn field_doubt(&self, lens: &Lens) -> Option<String> {
        let ([w, h], SizeReport { width, height }) = (lens.field?.size, self.report.photograph);
        if [w, h] != [width, height] {
            let problem = format!("is of {w}x{h} photographs, and these are {width}x{height}");
            return Some(format!(
                "{DOUBT}its field {problem}, so that it is left out: calibrate with photographs of their size"
            ));
        }
        self.report.flattened.then(|| {
            format!("{DOUBT}its field is left out, because --flat has already changed V: solve without --flat")
        })
    }

    /// Sets the focus positions of the frames of a sweep in mm, and computes depth from them. `nearer` states whether
    /// the first or the last frame is focused nearest.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the positions are not in mm, or do not fit the frames.
    pub fn set_positions(&mut self, positions: &Positions, nearer: Nearer) -> Result<(), Error> {
        let depth = positions.depth_of(&self.positions(), self.values(), self.uncertainty())?;
        let (Some(depth), Some(planes)) = (depth, positions.millimetres()) else {
            return Err(Error::Mismatch("positions in mm give depth".to_string()));
        };
        self.report.depth = Some(DepthReport::of_sweep(&depth, positions));
        (self.report.nearer, self.report.nearer_by) = (Some(nearer.number()), Some(NearerBy::Distances));
        self.report.frames.iter_mut().zip(planes).for_each(|(frame, at)| frame.focus_mm = Some(*at));
        self.depth = Some([depth.depth.into(), depth.deviation.into()]);
        Ok(())
    }

    /// Derives depth in mm from the lens or the positions that the report states.
    pub(super) fn read_depth(&mut self) -> Result<(), Error> {
        if let Some(lens) = self.lens() {
            let (metric, _) = self.depth_through(lens);
            self.depth = Some([metric.depth.into(), metric.deviation.into()]);
            return Ok(());
        }
        let planes = self.planes();
        if planes.len() == self.report.frames.len() {
            let is_stage = self.report.depth.as_ref().and_then(|depth| depth.stage) == Some(true);
            let positions = if is_stage { Positions::Stage(planes) } else { Positions::Distances(planes) };
            let depth = positions.depth_of(&self.positions(), self.values(), self.uncertainty())?;
            self.depth = depth.map(|depth| [depth.depth.into(), depth.deviation.into()]);
        }
        Ok(())
    }

    pub(in crate::files::export) fn depth_description(&self) -> &'static Description {
        match self.lens() {
            Some(_) => &METRIC_DEPTH,
            None => &SWEEP_DEPTH,
        }
    }
}
