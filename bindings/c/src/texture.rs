//! Surface texture of a height map, and the noise of repeated height maps.

use parfocal::metric::Estimate;
use parfocal::metric::inspect::Heights;
use parfocal::metric::measure::Line;
use parfocal::metric::repeat::{Interval, MOST_MAPS, repeated_maps};
use parfocal::metric::roughness::{Area, Evaluation, Form, Parameter, roughness};
use parfocal::{Error, Region};

use crate::fault::{Fault, call, parfocal_status};
use crate::handle::slice;
use crate::measure::{parfocal_estimate, pixels};
use crate::sized::{Versioned, read, stated_size, write};
use crate::solver::{mask, parfocal_region};

/// The form that is removed from heights.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub enum parfocal_form {
    /// The mean only.
    PARFOCAL_FORM_NONE = 0,
    /// A plane.
    PARFOCAL_FORM_PLANE = 1,
    /// A polynomial of second degree.
    PARFOCAL_FORM_QUADRIC = 2,
    /// A cylinder of any direction. Not for repeated height maps.
    PARFOCAL_FORM_CYLINDER = 3,
}

/// The evaluation of a surface. Zeros are the defaults, except for form, realizations and noise_window_px, which
/// parfocal_roughness_options_init sets to a plane, 20 and 4 px.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_roughness_options {
    /// sizeof(parfocal_roughness_options).
    pub size: usize,
    /// The part of the heights that is evaluated. Width 0: all of it.
    pub region: parfocal_region,
    /// One byte per pixel, row by row without gaps; pixels with 0 do not count. NULL: all pixels count.
    pub mask: *const u8,
    /// An error of each height of one standard deviation that all heights have in common, which deviation includes: for
    /// V scale_deviation times V. In the unit of the heights; where it is NaN or greater than deviation, there is no
    /// height. NULL: none.
    pub common: *const f32,
    /// A parfocal_form.
    pub form: i32,
    /// Not 0: the robust L-filter of ISO 16610-71.
    pub robust: i32,
    /// Cutoff wavelength of the S-filter, px. 0: no filter.
    pub s_filter_px: f64,
    /// Cutoff wavelength of the L-filter, px. 0: no filter.
    pub l_filter_px: f64,
    /// Ends of the line of Ra, Rq and Rz, px: x1, y1, x2, y2, and the width across it. Width 0: means over the rows.
    pub line: [f64; 5],
    /// The size of a pixel on the surface, in the unit of the heights. 0: not known; sdr is then NaN.
    pub pixel_size: f64,
    /// Standard deviation of the window over which a solve averages noise, px: 4 for a pair, 2 for a sweep.
    pub noise_window_px: f64,
    /// The number of realizations of noise from which standard deviations follow.
    pub realizations: u32,
    /// Always 0.
    pub reserved: u32,
}

// SAFETY: `repr(C)`, numbers and pointers, the size first.
unsafe impl Versioned for parfocal_roughness_options {
    const NAME: &'static str = "parfocal_roughness_options";

    fn start() -> Self {
        Self {
            size: size_of::<Self>(),
            region: parfocal_region { x: 0, y: 0, width: 0, height: 0 },
            mask: std::ptr::null(),
            common: std::ptr::null(),
            form: parfocal_form::PARFOCAL_FORM_PLANE as i32,
            robust: 0,
            s_filter_px: 0.0,
            l_filter_px: 0.0,
            line: [0.0; 5],
            pixel_size: 0.0,
            noise_window_px: 4.0,
            realizations: 20,
            reserved: 0,
        }
    }
}

/// A parameter of a surface with its standard deviation. NaN is not determined.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_parameter {
    /// The value.
    pub value: f64,
    /// The standard deviation: the root of the sum of the squares of both parts.
    pub standard_deviation: f64,
    /// The part by the noise of each height.
    pub by_noise: f64,
    /// The part by the error that all heights have in common; 0 if there is none.
    pub by_scale: f64,
    /// How much noise adds to the parameter. It is not subtracted.
    pub noise_bias: f64,
}

/// Surface texture: areal parameters of ISO 25178-2 and profile parameters of ISO 21920-2. Those that are heights are
/// in the unit of the heights.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_roughness {
    /// sizeof(parfocal_roughness).
    pub size: usize,
    /// Number of pixels of the region that the mask counts.
    pub area_px: usize,
    /// Number of measured pixels in it.
    pub measured_px: usize,
    /// Number of profiles of ra, rq and rz.
    pub profiles: usize,
    /// Number of section lengths of a profile.
    pub sections: usize,
    /// 1 if str is an upper bound.
    pub str_is_upper_bound: i32,
    /// Always 0.
    pub reserved: i32,
    /// Arithmetical mean height.
    pub sa: parfocal_parameter,
    /// Root mean square height.
    pub sq: parfocal_parameter,
    /// Skewness, a number.
    pub ssk: parfocal_parameter,
    /// Kurtosis, a number.
    pub sku: parfocal_parameter,
    /// Maximum peak height.
    pub sp: parfocal_parameter,
    /// Maximum pit depth.
    pub sv: parfocal_parameter,
    /// Maximum height.
    pub sz: parfocal_parameter,
    /// Root mean square gradient: a number, or unit of the heights per px if pixel_size is 0.
    pub sdq: parfocal_parameter,
    /// Developed interfacial area ratio, %.
    pub sdr: parfocal_parameter,
    /// Autocorrelation length, px.
    pub sal: parfocal_parameter,
    /// Texture aspect ratio, a number.
    pub str: parfocal_parameter,
    /// Arithmetical mean height of the profiles.
    pub ra: parfocal_parameter,
    /// Root mean square height of the profiles.
    pub rq: parfocal_parameter,
    /// Maximum height of the profiles, per section length.
    pub rz: parfocal_parameter,
}

// SAFETY: `repr(C)`, numbers, the size first.
unsafe impl Versioned for parfocal_roughness {
    const NAME: &'static str = "parfocal_roughness";

    fn start() -> Self {
        let nan = f64::NAN;
        let none =
            parfocal_parameter { value: nan, standard_deviation: nan, by_noise: nan, by_scale: nan, noise_bias: nan };
        let (size, count) = (size_of::<Self>(), 0);
        Self {
            size,
            area_px: count,
            measured_px: count,
            profiles: count,
            sections: count,
            str_is_upper_bound: 0,
            reserved: 0,
            sa: none,
            sq: none,
            ssk: none,
            sku: none,
            sp: none,
            sv: none,
            sz: none,
            sdq: none,
            sdr: none,
            sal: none,
            str: none,
            ra: none,
            rq: none,
            rz: none,
        }
    }
}

/// Fills in the default options.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_roughness_options_init(options: *mut parfocal_roughness_options) -> parfocal_status {
    // SAFETY: by the C contract.
    call(|| unsafe { write(options, parfocal_roughness_options::start()) })
}

/// Evaluates the texture of width x height heights, NaN where there is none, with their standard deviations, in any
/// unit. Heights are positive towards the camera: give depth in mm with the opposite sign. options may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_measure_roughness(
    heights: *const f32,
    deviation: *const f32,
    width: u32,
    height: u32,
    options: *const parfocal_roughness_options,
    found: *mut parfocal_roughness,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        unsafe { stated_size(found) }?;
        let start = parfocal_roughness_options::start();
        // SAFETY: by the C contract.
        let options = if options.is_null() { start } else { unsafe { read(options) }? };
        let count = pixels(width, height)?;
        // SAFETY: by the C contract, fields of width x height values.
        let (mut map, mask, common) = unsafe {
            let common = match options.common.is_null() {
                true => None,
                false => Some(slice(options.common, count, "common")?),
            };
            (map(heights, deviation, [width, height])?, mask(options.mask, [width, height])?, common)
        };
        if let Some(common) = common {
            map = map.without_common(common)?;
        }
        let given = |v: f64| (v != 0.0).then_some(v);
        let [x1, y1, x2, y2, across] = options.line;
        let evaluation = Evaluation {
            form: form(options.form)?,
            s_filter_px: given(options.s_filter_px),
            l_filter_px: given(options.l_filter_px),
            robust: options.robust != 0,
            line: given(across).map(|width| Line { from: [x1, y1], to: [x2, y2], width }),
            realizations: options.realizations as usize,
            noise_window_px: options.noise_window_px,
            pixel_size: given(options.pixel_size),
        };
        let area = Area { region: region(options.region, [width, height]), mask: mask.as_ref() };
        let texture = roughness(&map, common, &area, &evaluation)?;
        let parameter = |name: &str| {
            let nowhere = parfocal_roughness::start().sa;
            texture.parameters.iter().find(|found| found.name == name).map_or(nowhere, parfocal_parameter::from)
        };
        let filled = parfocal_roughness {
            size: size_of::<parfocal_roughness>(),
            area_px: texture.area_px,
            measured_px: texture.measured_px,
            profiles: texture.profiles,
            sections: texture.sections,
            str_is_upper_bound: texture.is_str_bound.into(),
            reserved: 0,
            sa: parameter("Sa"),
            sq: parameter("Sq"),
            ssk: parameter("Ssk"),
            sku: parameter("Sku"),
            sp: parameter("Sp"),
            sv: parameter("Sv"),
            sz: parameter("Sz"),
            sdq: parameter("Sdq"),
            sdr: parameter("Sdr"),
            sal: parameter("Sal"),
            str: parameter("Str"),
            ra: parameter("Ra"),
            rq: parameter("Rq"),
            rz: parameter("Rz"),
        };
        // SAFETY: by the C contract.
        unsafe { write(found, filled) }
    })
}

impl From<&Parameter> for parfocal_parameter {
    fn from(of: &Parameter) -> Self {
        let by_scale = of.by_scale.unwrap_or(0.0);
        let Parameter { value, standard_deviation, by_noise, noise_bias, .. } = *of;
        Self { value, standard_deviation, by_noise, by_scale, noise_bias }
    }
}

/// A value with its interval of 95 %.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_interval {
    /// The value.
    pub value: f64,
    /// The lower end.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

/// The noise of repeated height maps of one unmoved part, in the unit of the heights.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_repeatability {
    /// sizeof(parfocal_repeatability).
    pub size: usize,
    /// Number of pixels of the region that the mask counts.
    pub area_px: usize,
    /// Number of them that all maps measure.
    pub measured_px: usize,
    /// Measurement noise of a map (ISO 25178-700).
    pub noise: parfocal_estimate,
    /// Median, least and greatest noise of a pair of maps.
    pub pair_noise: [f64; 3],
    /// What two measurements of a pixel differ by in 95 of 100 cases at most.
    pub repeatability_limit: parfocal_estimate,
    /// Standard deviation of the mean height between maps.
    pub shift_deviation: parfocal_interval,
    /// Root mean square of the stated standard deviations.
    pub stated: f64,
    /// Differences over their stated standard deviations, root mean square: 1 if these are right.
    pub seen_over_stated: parfocal_estimate,
    /// Share of the differences within 1 of their stated standard deviations: 0.683 if these are right.
    pub within_1: parfocal_estimate,
    /// Share within 2: 0.954 if these are right.
    pub within_2: parfocal_estimate,
}

// SAFETY: `repr(C)`, numbers, the size first.
unsafe impl Versioned for parfocal_repeatability {
    const NAME: &'static str = "parfocal_repeatability";

    fn start() -> Self {
        let nan = f64::NAN;
        let none = parfocal_estimate { value: nan, standard_error: nan };
        Self {
            size: size_of::<Self>(),
            area_px: 0,
            measured_px: 0,
            noise: none,
            pair_noise: [nan; 3],
            repeatability_limit: none,
            shift_deviation: parfocal_interval { value: nan, low: nan, high: nan },
            stated: nan,
            seen_over_stated: none,
            within_1: none,
            within_2: none,
        }
    }
}

/// Compares count height maps of one unmoved part, 2 to 200, each of width x height heights with their standard
/// deviations: without the part that all maps have in common, such as that of the scale of V. The form, a
/// parfocal_form, is subtracted from their differences. region may be NULL: all of the maps. mask has one byte per
/// pixel and may be NULL: all pixels count.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_measure_repeatability(
    heights: *const *const f32,
    deviations: *const *const f32,
    count: usize,
    width: u32,
    height: u32,
    region: *const parfocal_region,
    mask: *const u8,
    form: i32,
    found: *mut parfocal_repeatability,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        unsafe { stated_size(found) }?;
        if !(2..=MOST_MAPS).contains(&count) {
            let problem = format!("{count} height maps cannot be compared: give 2 to {MOST_MAPS}");
            return Err(Error::Mismatch(problem).into());
        }
        let size = [width, height];
        // SAFETY: by the C contract, `count` pointers to fields of width x height values.
        let (maps, mask, part) = unsafe {
            let both = slice(heights, count, "heights")?.iter().zip(slice(deviations, count, "deviations")?);
            let maps = both.map(|(heights, deviation)| map(*heights, *deviation, size));
            (maps.collect::<Result<Vec<_>, _>>()?, self::mask(mask, size)?, region.as_ref())
        };
        let part = part.map_or(Region { x: 0, y: 0, width, height }, |part| self::region(*part, size));
        let of = repeated_maps(&maps, &Area { region: part, mask: mask.as_ref() }, self::form(form)?)?;
        let estimate = |Estimate { value, standard_error }| parfocal_estimate { value, standard_error };
        let Interval { value, low, high } = of.shift_deviation;
        let [within_1, within_2] = of.within.map(estimate);
        let filled = parfocal_repeatability {
            size: size_of::<parfocal_repeatability>(),
            area_px: of.area_px,
            measured_px: of.measured_px,
            noise: estimate(of.noise),
            pair_noise: of.pair_noise,
            repeatability_limit: estimate(of.repeatability_limit),
            shift_deviation: parfocal_interval { value, low, high },
            stated: of.stated,
            seen_over_stated: estimate(of.seen_over_stated),
            within_1,
            within_2,
        };
        // SAFETY: by the C contract.
        unsafe { write(found, filled) }
    })
}

/// # Safety
/// Both pointers are NULL, or point to width x height floats.
unsafe fn map(heights: *const f32, deviation: *const f32, size: [u32; 2]) -> Result<Heights, Fault> {
    let count = pixels(size[0], size[1])?;
    // SAFETY: by the C contract.
    let (heights, deviation) = unsafe { (slice(heights, count, "heights")?, slice(deviation, count, "deviation")?) };
    Ok(Heights::new(size, heights, deviation)?)
}

fn region(of: parfocal_region, [width, height]: [u32; 2]) -> Region {
    if of.width == 0 { Region { x: 0, y: 0, width, height } } else { of.into() }
}

fn form(form: i32) -> Result<Form, Fault> {
    use parfocal_form::{PARFOCAL_FORM_CYLINDER, PARFOCAL_FORM_NONE, PARFOCAL_FORM_PLANE, PARFOCAL_FORM_QUADRIC};
    Ok(match form {
        _ if form == PARFOCAL_FORM_NONE as i32 => Form::None,
        _ if form == PARFOCAL_FORM_PLANE as i32 => Form::Plane,
        _ if form == PARFOCAL_FORM_QUADRIC as i32 => Form::Quadric,
        _ if form == PARFOCAL_FORM_CYLINDER as i32 => Form::Cylinder,
        _ => return Err(Fault::argument(format!("{form} is no parfocal_form"))),
    })
}
