//! What a file holds, in words, for its own metadata.

use std::borrow::Cow;

/// The program and its version, as files name what wrote them.
pub(crate) const SOFTWARE: &str = concat!("parfocal ", env!("CARGO_PKG_VERSION"));

/// Unit and content of a field or picture, in ASCII.
pub(crate) struct Meaning {
    pub(crate) units: &'static str,
    pub(crate) comments: Cow<'static, str>,
}

impl Meaning {
    pub(crate) const fn new(units: &'static str, comments: &'static str) -> Self {
        Self { units, comments: Cow::Borrowed(comments) }
    }
}

/// V.
pub(crate) const RELATIVE_BLUR: Meaning = Meaning::new(
    "px^2",
    "Relative blur V in px^2 of the first image; positive where the second is the more blurred, less the field \
     curvature where report.json says flattened; NaN outside the valid region",
);

/// σ_V.
pub(crate) const UNCERTAINTY: Meaning = Meaning::new(
    "px^2",
    "Standard deviation of the relative blur V in px^2; NaN outside the valid region, 1000 where the images say nothing",
);

/// 1/(1 + σ_V²).
pub(crate) const CONFIDENCE: Meaning =
    Meaning::new("1", "1/(1 + s^2), s the standard deviation of V in px^2: 0.5 at 1 px^2; 0 outside the valid region");

/// What nothing explains.
pub(crate) const RESIDUAL: Meaning = Meaning::new(
    "1",
    "Root mean square, around each pixel, of what neither blur nor registration explains, in intensities with white at 1; \
     NaN outside the valid region",
);

/// u of a sweep.
pub(crate) const FOCUS: Meaning = Meaning::new(
    "focus settings",
    "Focus setting at which each pixel of the reference frame is sharp, in the focus_unit of report.json; NaN where no \
     pair of frames tells, and where it lies before the first frame or beyond the last",
);

/// Which frame the fused image is of.
pub(crate) const FRAMES: Meaning =
    Meaning::new("label", "The frame of the sweep that each pixel of the fused image is taken from, counted from 1");

/// What no frame of a sweep has in focus.
pub(crate) const BEYOND: Meaning = Meaning::new(
    "label",
    "1 where the focus lies before the first frame of the sweep, 2 where it lies beyond the last, and no frame is in focus; else 0",
);

/// True u of a sweep.
pub(crate) const TRUE_FOCUS: Meaning = Meaning::new(
    "focus settings",
    "Focus setting, as the positions in truth.json, at which each pixel of the reference frame is sharp",
);

/// Its standard deviation.
pub(crate) const FOCUS_UNCERTAINTY: Meaning =
    Meaning::new("focus settings", "Standard deviation of the focus setting; NaN where there is none");

/// A photograph in floats.
pub(crate) const INTENSITY: Meaning = Meaning::new("1", "Intensity, white at 1");

/// A photograph in integers.
pub(crate) const PHOTOGRAPH: Meaning = Meaning::new("1", "Intensity, white at the largest sample");

/// The fused image in integers.
pub(crate) const FUSED: Meaning = Meaning::new(
    "1",
    "Best focus: of each pixel the sharpest photograph, at the pixels and in the values of the first (of a sweep, of the \
     reference frame); white at the largest sample, values beyond black and white clipped",
);

/// The fused image in floats.
pub(crate) const FUSED_FLOAT: Meaning = Meaning::new(
    "1",
    "Best focus: of each pixel the sharpest photograph, at the pixels and in the values of the first (of a sweep, of the \
     reference frame); white at 1, nothing clipped",
);

/// True depth.
pub(crate) const DEPTH: Meaning = Meaning::new("mm", "Depth in mm from the lens, at the pixels of the first image");

/// Depth by the lens, and its standard deviation.
pub(crate) const METRIC_DEPTH: Meaning = Meaning::new(
    "mm",
    "Y: depth in mm from the lens, at the pixels of the first image; standard_deviation: that of Y in mm, from the \
     uncertainty of the relative blur; NaN outside the valid region and the range of the lens model",
);

/// Depth of a sweep, and its standard deviation.
pub(crate) const SWEEP_DEPTH: Meaning = Meaning::new(
    "mm",
    "Y: depth in mm, from the lens or along the axis of the stage, at the pixels of the reference frame; \
     standard_deviation: that of Y in mm; NaN where no pair of frames tells",
);

/// A curve.
pub(crate) const PROFILE: Meaning = Meaning::new("1", "Profile with one standard deviation to either side");
