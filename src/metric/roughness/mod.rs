//! Surface texture: areal parameters of ISO 25178-2 and profile parameters of ISO 21920-2, with standard deviations.

mod areal;
mod autocorrelation;
mod filter;
mod form;
mod noise;
#[cfg(test)]
mod peer;
mod profile;

use self::areal::Surface;
use self::filter::Filters;
use self::noise::{Noise, scatter};
use self::profile::ProfileParameters;
use super::heights::Heights;
use super::measure::{Line, Values};
use crate::base::{Error, Mask, Region, workers};

pub use self::filter::LEAST_CUTOFF;
pub use self::form::Form;

/// The smallest number of measured pixels of a surface.
const LEAST_PIXELS: usize = 256;
/// Bounds of the number of realizations: one has no scatter.
const LEAST_REALIZATIONS: usize = 2;
const MOST_REALIZATIONS: usize = 10_000;
/// The largest standard deviation of the window of noise, px.
const MOST_WINDOW: f64 = 100.0;
/// The largest number of pixels of the realizations that are evaluated at a time, for memory: some 1 GB.
const MAX_IN_FLIGHT: usize = 1 << 24;

/// The part of the results that is evaluated.
#[derive(Clone, Copy, Debug)]
pub struct Area<'a> {
    /// The region. Forms and filters use no pixel outside.
    pub region: Region,
    /// A mask of the size of the heights.
    pub mask: Option<&'a Mask>,
}

/// How a surface is evaluated.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Evaluation {
    /// The form that is removed.
    pub form: Form,
    /// Cutoff wavelength of the S-filter, px, which removes shorter waves.
    pub s_filter_px: Option<f64>,
    /// Cutoff wavelength of the L-filter, px, which removes longer waves.
    pub l_filter_px: Option<f64>,
    /// Whether the L-filter is the robust one of ISO 16610-71.
    pub robust: bool,
    /// The line of the profile parameters. Without one they are means over the rows.
    pub line: Option<Line>,
    /// The number of realizations of noise from which standard deviations follow.
    pub realizations: usize,
    /// Standard deviation of the Gaussian window over which noise is averaged, px; 0 for independent pixels.
    pub noise_window_px: f64,
    /// The size of a pixel on the surface in the unit of the heights. `None` if it is not known, or heights are no
    /// lengths; then Sdr is not defined.
    pub pixel_size: Option<f64>,
}

/// The dimension of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// The unit of the heights. Such a parameter is proportional to the heights.
    Height,
    /// A number.
    Number,
    /// Heights per [`pixel_size`](Evaluation::pixel_size), or per px.
    Gradient,
    /// Per cent.
    Percent,
    /// A lateral length, px.
    Length,
}

/// The parameters and their dimensions, in the order of a [`Roughness`].
pub const PARAMETERS: [(&str, Dimension); 14] = [
    ("Sa", Dimension::Height),
    ("Sq", Dimension::Height),
    ("Ssk", Dimension::Number),
    ("Sku", Dimension::Number),
    ("Sp", Dimension::Height),
    ("Sv", Dimension::Height),
    ("Sz", Dimension::Height),
    ("Sdq", Dimension::Gradient),
    ("Sdr", Dimension::Percent),
    ("Sal", Dimension::Length),
    ("Str", Dimension::Number),
    ("Ra", Dimension::Height),
    ("Rq", Dimension::Height),
    ("Rz", Dimension::Height),
];

/// A parameter with its standard deviation. NaN is not determined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Its symbol.
    pub name: &'static str,
    /// Its dimension.
    pub dimension: Dimension,
    /// The value.
    pub value: f64,
    /// The standard deviation: the root of the sum of the squares of both parts.
    pub standard_deviation: f64,
    /// The part of the standard deviation by the noise of each height: the scatter of the realizations.
    pub by_noise: f64,
    /// The part by an error that all heights have in common, that of the scale of V. `None` if there is none.
    pub by_scale: Option<f64>,
    /// How much noise adds to the parameter: the mean of the realizations, less the value. It is not subtracted.
    pub noise_bias: f64,
}

/// The surface texture of an area.
#[derive(Clone, Debug, PartialEq)]
pub struct Roughness {
    /// The number of pixels of the area: in the region and in the mask.
    pub area_px: usize,
    /// The number of measured pixels in it. The others are missing.
    pub measured_px: usize,
    /// The number of profiles of the profile parameters, which are NaN if there is none.
    pub profiles: usize,
    /// The number of section lengths of a profile.
    pub sections: usize,
    /// Whether Str is an upper bound: heights are correlated as far as the area reaches in some direction.
    pub is_str_bound: bool,
    /// The parameters, as in [`PARAMETERS`].
    pub parameters: Vec<Parameter>,
}

impl Evaluation {
    /// Checks the cutoffs, the area and the line against the size of the results, and the other numbers.
    ///
    /// # Errors
    /// [`Error::Region`], or [`Error::Mismatch`] for numbers.
    pub fn check(&self, region: Region, [width, height]: [u32; 2]) -> Result<(), Error> {
        region.check((width, height))?;
        self.line.iter().try_for_each(|line| line.check((width, height)))?;
        let wrong =
            |what: &str, value: f64, range: &str| Err(Error::Mismatch(format!("{what} is {value}: give {range}")));
        if !(LEAST_REALIZATIONS..=MOST_REALIZATIONS).contains(&self.realizations) {
            let range = format!("{LEAST_REALIZATIONS} to {MOST_REALIZATIONS}");
            return wrong("the number of realizations", self.realizations as f64, &range);
        }
        if !(0.0..=MOST_WINDOW).contains(&self.noise_window_px) {
            return wrong("the noise window", self.noise_window_px, &format!("0 to {MOST_WINDOW} px"));
        }
        if let Some(size) = self.pixel_size.filter(|size| !(*size > 0.0 && size.is_finite())) {
            return wrong("the size of a pixel", size, "one above 0");
        }
        let shorter = f64::from(region.width.min(region.height));
        let reach = self.line.map_or(shorter, |line| shorter.min(line.length()));
        for (name, cutoff) in [("S-filter", self.s_filter_px), ("L-filter", self.l_filter_px)] {
            let Some(cutoff) = cutoff else { continue };
            if cutoff.is_nan() || cutoff < LEAST_CUTOFF {
                let problem = format!("must be at least {LEAST_CUTOFF} px, since pixels do not sample a shorter wave");
                return Err(Error::Mismatch(format!("the cutoff of the {name} is {cutoff:.4} px, and {problem}")));
            }
            if cutoff > reach {
                let problem = format!("is longer than the area or the line, {reach:.0} px; give a shorter one");
                return Err(Error::Mismatch(format!("the cutoff of the {name}, {cutoff:.4} px, {problem}")));
            }
        }
        if let (Some(s), Some(l)) = (self.s_filter_px, self.l_filter_px)
            && s >= l
        {
            let problem = "no waves are left between them; give an S-filter shorter than the L-filter";
            return Err(Error::Mismatch(format!(
                "the S-filter, {s:.4} px, is not below the L-filter, {l:.4} px: {problem}"
            )));
        }
        Ok(())
    }

    /// Returns the parameters of a surface, and whether Str is a bound.
    fn evaluate(&self, surface: &Surface, line: Option<&Line>, filters: &Filters) -> Result<Evaluated, Error> {
        let mut levelled = surface.clone();
        levelled.subtract_form(self.form, self.pixel_size)?;
        let profile = match line {
            None => ProfileParameters::of_rows(&levelled, filters),
            Some(line) => ProfileParameters::of_profile(&along(&levelled, line)?, filters),
        };
        let filtered = filters.apply(levelled);
        let (height, spatial) = (filtered.height_parameters(), filtered.spatial_parameters());
        let values = [
            height.sa,
            height.sq,
            height.ssk,
            height.sku,
            height.sp,
            height.sv,
            height.sz,
            filtered.sdq(self.pixel_size.unwrap_or(1.0)),
            self.pixel_size.map_or(f64::NAN, |pixel| filtered.sdr(pixel)),
            spatial.sal,
            spatial.str,
            profile.ra,
            profile.rq,
            profile.rz,
        ];
        Ok(Evaluated { values, is_str_bound: spatial.is_bound, profiles: profile.profiles })
    }
}

/// The parameters of one surface.
struct Evaluated {
    values: [f64; PARAMETERS.len()],
    is_str_bound: bool,
    profiles: usize,
}

/// Returns the heights along a line.
fn along(surface: &Surface, line: &Line) -> Result<Vec<f64>, Error> {
    let values: Vec<f32> = surface.values.iter().map(|z| *z as f32).collect();
    Values { width: surface.width as u32, values: &values }.profile(line)
}

/// Evaluates the surface texture of heights in an area.
///
/// `common` is an error of the heights of one standard deviation that all have in common, in the unit of the heights:
/// for V the standard deviation of its scale. It is not in the standard deviations of `heights`.
///
/// # Errors
/// As for [`Evaluation::check`]; [`Error::Region`] if too few pixels are measured, or if they do not determine the
/// form; [`Error::Mismatch`] if a field has another size.
pub fn roughness(
    heights: &Heights,
    common: Option<&[f32]>,
    area: &Area<'_>,
    evaluation: &Evaluation,
) -> Result<Roughness, Error> {
    let (size, region) = ([heights.width, heights.height], area.region);
    evaluation.check(region, size)?;
    let pixels = heights.values.len();
    if common.is_some_and(|common| common.len() != pixels) {
        let [width, height] = size;
        return Err(Error::Mismatch(format!("errors must have {width}x{height} pixels, as the heights")));
    }
    let cut = |field: &[f32]| -> Vec<f64> {
        region.crop(field, heights.width as usize, 1).into_iter().map(f64::from).collect()
    };
    let (surface, area_px) = area.surface(cut(&heights.values), size)?;
    let measured_px = surface.measured();
    if measured_px < LEAST_PIXELS {
        let problem = format!("roughness needs {LEAST_PIXELS}: give a larger area");
        return Err(Error::Region(format!(
            "only {measured_px} of the area's {area_px} pixels are measured, and {problem}"
        )));
    }
    let mut filters = Filters::new(evaluation.s_filter_px, evaluation.l_filter_px);
    filters.is_robust = evaluation.robust;
    let line = evaluation.line.map(|line| line.within(region)).transpose()?;
    let evaluate = |surface: &Surface| evaluation.evaluate(surface, line.as_ref(), &filters);
    let found = evaluate(&surface)?;
    if line.is_some() && found.profiles == 0 {
        return Err(Error::Region("less than half of the line is measured: give another line".to_string()));
    }
    // A realization that does not determine its form does not count.
    let values_of = |surface: &Surface| evaluate(surface).map_or([f64::NAN; PARAMETERS.len()], |found| found.values);
    let deviation = cut(&heights.deviation);
    let noise = Noise { deviation: &deviation, window: evaluation.noise_window_px };
    let at_a_time = (MAX_IN_FLIGHT / surface.values.len()).max(1);
    let realized = |n: usize| values_of(&noise.add_to(&surface, n as u64));
    let realizations = in_portions(evaluation.realizations, at_a_time, realized);
    let ends = common.map(|common| {
        let common = cut(common);
        [1.0, -1.0].map(|sign| {
            let moved = surface.values.iter().zip(&common).map(|(z, error)| z + sign * error).collect();
            values_of(&Surface { width: surface.width, values: moved })
        })
    });
    let parameter = |n: usize| {
        let ((name, dimension), value) = (PARAMETERS[n], found.values[n]);
        let (by_noise, mean) = scatter(realizations.iter().map(|values| values[n]));
        let by_scale = ends.map(|[up, down]| (up[n] - down[n]).abs() / 2.0);
        let standard_deviation = by_noise.hypot(by_scale.unwrap_or(0.0));
        Parameter { name, dimension, value, standard_deviation, by_noise, by_scale, noise_bias: mean - value }
    };
    let length = line.map_or(region.width as usize, |line| line.points().count());
    Ok(Roughness {
        area_px,
        measured_px,
        profiles: found.profiles,
        sections: profile::sections(length, evaluation.l_filter_px),
        is_str_bound: found.is_str_bound,
        parameters: (0..PARAMETERS.len()).map(parameter).collect(),
    })
}

/// Computes values by their number in parallel, some at a time.
fn in_portions<T: Send>(count: usize, at_a_time: usize, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let mut all = Vec::new();
    while all.len() < count {
        let first = all.len();
        all.extend(workers::map((count - first).min(at_a_time), |n| value(first + n)));
    }
    all
}

impl Area<'_> {
    /// Returns whether each pixel of the region is in the area, and the number of those that are. Maps of heights have
    /// this size.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the mask has another size.
    pub(super) fn inside(&self, size: [u32; 2]) -> Result<(Vec<bool>, usize), Error> {
        let Some(mask) = self.mask else {
            let pixels = self.region.width as usize * self.region.height as usize;
            return Ok((vec![true; pixels], pixels));
        };
        if mask.size() != size {
            let [width, height] = size;
            return Err(Error::Mismatch(format!("the mask must have {width}x{height} pixels, as the heights")));
        }
        let cut = self.region.crop(mask.bytes(), size[0] as usize, 1);
        let inside: Vec<bool> = cut.into_iter().map(|inside| inside != 0).collect();
        let pixels = inside.iter().filter(|inside| **inside).count();
        Ok((inside, pixels))
    }

    /// Returns the surface of the region's heights without those outside of the mask, and the number of pixels of the
    /// area. Maps of heights have this size.
    fn surface(&self, mut values: Vec<f64>, size: [u32; 2]) -> Result<(Surface, usize), Error> {
        let (inside, pixels) = self.inside(size)?;
        values.iter_mut().zip(&inside).filter(|(_, inside)| !**inside).for_each(|(z, _)| *z = f64::NAN);
        Ok((Surface { width: self.region.width as usize, values }, pixels))
    }
}

/// Returns row-major heights without their form, which is fitted to those that are finite.
///
/// # Errors
/// [`Error::Region`] if they do not determine the form.
pub(super) fn without_form(width: usize, values: Vec<f64>, form: Form) -> Result<Vec<f64>, Error> {
    let mut surface = Surface { width, values };
    surface.subtract_form(form, None)?;
    Ok(surface.values)
}

impl Line {
    /// Returns the line on the pixels of a region.
    fn within(&self, region: Region) -> Result<Self, Error> {
        let moved = |[x, y]: [f64; 2]| [x - f64::from(region.x), y - f64::from(region.y)];
        let line = Self { from: moved(self.from), to: moved(self.to), width: self.width };
        let inside = line.check((region.width, region.height));
        inside.map(|()| line).map_err(|_| {
            let [[x1, y1], [x2, y2]] = [self.from, self.to];
            let Region { x, y, width, height } = region;
            Error::Region(format!("the line {x1},{y1},{x2},{y2} leaves the region {x},{y},{width},{height}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::areal::tests::close;
    use super::*;

    const SIZE: [u32; 2] = [96, 80];
    const WHOLE: Region = Region { x: 0, y: 0, width: 96, height: 80 };

    fn plain() -> Evaluation {
        Evaluation {
            form: Form::Plane,
            s_filter_px: None,
            l_filter_px: None,
            robust: false,
            line: None,
            realizations: 20,
            noise_window_px: 2.0,
            pixel_size: Some(1.0),
        }
    }

    /// Waves of several directions on a tilt.
    fn relief() -> Vec<f32> {
        let waves = |x: f64, y: f64| {
            let wave = |kx: f64, ky: f64, phase: f64| (TAU * (kx * x + ky * y) + phase).sin();
            0.5 * wave(0.05, 0.02, 0.3) + 0.4 * wave(-0.03, 0.06, 1.9) + 0.3 * wave(0.08, -0.01, 4.0) + 0.05 * x
        };
        (0..96 * 80).map(|i| waves((i % 96) as f64, (i / 96) as f64) as f32).collect()
    }

    fn evaluated(values: &[f32], sigma: f32, evaluation: &Evaluation) -> Roughness {
        let heights = Heights::new(SIZE, values, &vec![sigma; values.len()]).unwrap();
        roughness(&heights, None, &Area { region: WHOLE, mask: None }, evaluation).unwrap()
    }

    #[test]
    fn noise_of_known_deviation_gives_the_stated_scatter_and_bias() {
        let (sigma, relief) = (0.1, relief());
        let quick = Evaluation { s_filter_px: Some(6.0), l_filter_px: Some(40.0), ..plain() };
        let truth = evaluated(&relief, 0.0, &quick);
        let surface = Surface { width: 96, values: relief.iter().map(|z| f64::from(*z)).collect() };
        let deviation = vec![sigma; relief.len()];
        let measured: Vec<Roughness> = (0..30)
            .map(|n| {
                let noisy = Noise { deviation: &deviation, window: 2.0 }.add_to(&surface, 1000 + n);
                let values: Vec<f32> = noisy.values.iter().map(|z| *z as f32).collect();
                evaluated(&values, sigma as f32, &quick)
            })
            .collect();
        for (n, (name, _)) in PARAMETERS.iter().enumerate() {
            let (actual, mean) = scatter(measured.iter().map(|found| found.parameters[n].value));
            let (_, stated) = scatter(measured.iter().map(|found| found.parameters[n].standard_deviation));
            let (_, bias) = scatter(measured.iter().map(|found| found.parameters[n].noise_bias));
            let exact = truth.parameters[n].value;
            println!(
                "{name:<4} {exact:.4}: scatter {actual:.4}, stated {stated:.4}; bias {:.4}, stated {bias:.4}",
                mean - exact
            );
            // Str jumps where noise joins or separates parts of the autocorrelation's peak.
            let range = if *name == "Str" { 0.4..3.0 } else { 0.6..1.6 };
            assert!(range.contains(&(stated / actual)), "{name}: {stated}, and the scatter is {actual}");
            // The noise of the measurement makes the relief steeper already, so that more noise adds less.
            assert!((mean - exact - bias).abs() < 0.5 * (mean - exact).abs() + stated, "{name}: {mean} {exact} {bias}");
        }
        assert!(truth.parameters.iter().all(|p| p.standard_deviation < 1e-9 && p.by_scale.is_none()));
    }

    #[test]
    fn an_error_of_the_scale_is_the_same_share_of_every_height() {
        let (values, share) = (relief(), 0.15f32);
        let heights = Heights::new(SIZE, &values, &vec![0.05; values.len()]).unwrap();
        let common: Vec<f32> = values.iter().map(|v| share * v).collect();
        let area = Area { region: WHOLE, mask: None };
        let found = roughness(&heights, Some(&common), &area, &plain()).unwrap();
        for parameter in &found.parameters {
            let by_scale = parameter.by_scale.unwrap();
            match parameter.dimension {
                Dimension::Height | Dimension::Gradient => close(by_scale, 0.15 * parameter.value, 1e-5),
                Dimension::Number | Dimension::Length => assert!(by_scale < 1e-5, "{parameter:?}"),
                // Twice, since a small gradient counts by its square.
                Dimension::Percent => close(by_scale, 0.3 * parameter.value, 0.05),
            }
            close(parameter.standard_deviation, parameter.by_noise.hypot(by_scale), 1e-12);
        }
        assert_eq!(found, roughness(&heights, Some(&common), &area, &plain()).unwrap(), "realizations are seeded");
    }

    #[test]
    fn a_mask_and_missing_pixels_leave_pixels_out() {
        let mut values = relief();
        let picture = (0..96 * 80).map(|i| if i % 96 < 60 { 1.0 } else { 0.0 }).collect();
        let mask = Mask::from_image(&crate::base::Frame::gray(96, 80, picture).unwrap());
        for i in 0..values.len() {
            if i % 96 >= 60 {
                values[i] = 1e6;
            } else if i % 7 == 0 {
                values[i] = f32::NAN;
            }
        }
        let heights = Heights::new(SIZE, &values, &vec![0.05; values.len()]).unwrap();
        let evaluation = Evaluation { s_filter_px: Some(8.0), l_filter_px: Some(30.0), robust: true, ..plain() };
        let found = roughness(&heights, None, &Area { region: WHOLE, mask: Some(&mask) }, &evaluation).unwrap();
        assert_eq!((found.area_px, found.measured_px), (4800, values.iter().filter(|z| **z < 1e5).count()));
        let region = Region { x: 0, y: 0, width: 60, height: 80 };
        let cut = roughness(&heights, None, &Area { region, mask: None }, &evaluation).unwrap();
        for (a, b) in found.parameters.iter().zip(&cut.parameters) {
            // Sections of rows differ in length.
            assert!(a.name == "Rz" || (a.value / b.value - 1.0).abs() < 1e-6, "{a:?} {b:?}");
        }
    }

    #[test]
    fn areal_parameters_do_not_need_a_row_that_is_half_measured() {
        let mut values = relief();
        values.iter_mut().enumerate().filter(|(i, _)| i % 96 >= 40).for_each(|(_, z)| *z = f32::NAN);
        let found = evaluated(&values, 0.0, &plain());
        assert!(found.profiles == 0 && found.parameters[0].value > 0.1 && found.parameters[11].value.is_nan());
        let heights = Heights::new(SIZE, &values, &vec![0.0; values.len()]).unwrap();
        let line = Some(Line { from: [0.0, 9.0], to: [95.0, 9.0], width: 1.0 });
        let area = Area { region: WHOLE, mask: None };
        let error = roughness(&heights, None, &area, &Evaluation { line, ..plain() }).unwrap_err();
        assert!(error.to_string().contains("less than half of the line"), "{error}");
    }

    #[test]
    fn a_line_is_evaluated_on_the_pixels_of_the_results() {
        let heights = Heights::new(SIZE, &relief(), &vec![0.0; 96 * 80]).unwrap();
        let line = Some(Line { from: [20.0, 30.0], to: [80.0, 30.0], width: 1.0 });
        let region = Region { x: 10, y: 20, width: 80, height: 50 };
        let along = Evaluation { line, form: Form::None, ..plain() };
        let found = roughness(&heights, None, &Area { region, mask: None }, &along).unwrap();
        let row: Vec<f64> = heights.values[30 * 96 + 20..=30 * 96 + 80].iter().map(|z| f64::from(*z)).collect();
        let expected = ProfileParameters::of_profile(&row, &Filters::default());
        close(found.parameters[12].value, expected.rq, 1e-6);
        assert_eq!((found.profiles, found.sections), (1, 5));
    }

    #[test]
    fn areas_and_cutoffs_that_do_not_fit_are_refused_with_a_reason() {
        let mut values = relief();
        values[200..].fill(f32::NAN);
        let few = Heights::new(SIZE, &values, &vec![0.0; values.len()]).unwrap();
        let refused = |region: Region, evaluation: &Evaluation| {
            roughness(&few, None, &Area { region, mask: None }, evaluation).unwrap_err().to_string()
        };
        let line = |from, to| Some(Line { from, to, width: 1.0 });
        let small = Region { x: 10, y: 10, width: 30, height: 20 };
        for (region, evaluation, part) in [
            (WHOLE, plain(), "only 200 of the area's 7680 pixels"),
            (Region { x: 90, ..WHOLE }, plain(), "not within the image"),
            (WHOLE, Evaluation { s_filter_px: Some(3.0), ..plain() }, "at least 4 px"),
            (WHOLE, Evaluation { s_filter_px: Some(f64::NAN), ..plain() }, "at least 4 px"),
            (WHOLE, Evaluation { l_filter_px: Some(-9.0), ..plain() }, "at least 4 px"),
            (small, Evaluation { l_filter_px: Some(25.0), ..plain() }, "longer than the area"),
            (
                WHOLE,
                Evaluation { s_filter_px: Some(20.0), l_filter_px: Some(20.0), ..plain() },
                "not below the L-filter",
            ),
            (WHOLE, Evaluation { line: line([0.0, 0.0], [96.0, 0.0]), ..plain() }, "leaves the image"),
        ] {
            let message = refused(region, &evaluation);
            assert!(message.contains(part), "{part:?} in {message}");
        }
        let heights = Heights::new(SIZE, &relief(), &vec![0.0; 96 * 80]).unwrap();
        let outside = Evaluation { line: line([0.0, 0.0], [30.0, 15.0]), ..plain() };
        let error = roughness(&heights, None, &Area { region: small, mask: None }, &outside).unwrap_err().to_string();
        assert!(error.contains("leaves the region 10,10,30,20"), "{error}");
    }
}
