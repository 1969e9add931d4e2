//! Descriptions of files, for their own metadata and for the report.

use std::borrow::Cow;

/// Program and version, for the metadata of files.
pub(crate) const SOFTWARE: &str = concat!("parfocal ", env!("CARGO_PKG_VERSION"));

/// Unit and content of a field or a picture, ASCII.
pub(crate) struct Description {
    pub(crate) units: Cow<'static, str>,
    pub(crate) comments: Cow<'static, str>,
}

impl Description {
    pub(crate) const fn new(units: &'static str, comments: &'static str) -> Self {
        Self { units: Cow::Borrowed(units), comments: Cow::Borrowed(comments) }
    }
}

/// Relative blur V.
pub(crate) static RELATIVE_BLUR: Description = Description::new(
    "px^2",
    "Relative blur V in px^2 of the first image; positive where the second is the more blurred, less the field \
     curvature where report.json says flattened; NaN outside the valid region",
);

/// Standard deviation of V.
pub(crate) static UNCERTAINTY: Description = Description::new(
    "px^2",
    "Standard deviation of the relative blur V in px^2; NaN outside the valid region, 1000 where the images say nothing",
);

/// Confidence in V.
pub(crate) static CONFIDENCE: Description = Description::new(
    "1",
    "1/(1 + s^2), s the standard deviation of V in px^2: 0.5 at 1 px^2; 0 outside the valid region",
);

/// Residual.
pub(crate) static RESIDUAL: Description = Description::new(
    "1",
    "Root mean square, around each pixel, of what neither blur nor registration explains, in intensities with white at 1; \
     NaN outside the valid region",
);

/// Focus of a sweep.
pub(crate) static FOCUS: Description = Description::new(
    "focus settings",
    "Focus setting at which each pixel of the reference frame is sharp, in the focus_unit of report.json; NaN where no \
     pair of frames determines it, and where it lies before the first frame or beyond the last",
);

/// Frame of the fused image.
pub(crate) static FRAMES: Description = Description::new(
    "label",
    "The frame of the sweep that each pixel of the fused image is taken from, counted from 1",
);

/// Pixels of a sweep that no frame has in focus.
pub(crate) static BEYOND: Description = Description::new(
    "label",
    "1 where the focus lies before the first frame of the sweep, 2 where it lies beyond the last, and no frame is in focus; else 0",
);

/// True focus of a synthetic sweep.
pub(crate) static TRUE_FOCUS: Description = Description::new(
    "focus settings",
    "Focus setting, as the positions in truth.json, at which each pixel of the reference frame is sharp",
);

/// Standard deviation of the focus of a sweep.
pub(crate) static FOCUS_UNCERTAINTY: Description =
    Description::new("focus settings", "Standard deviation of the focus setting; NaN where there is none");

/// Photograph in floats.
pub(crate) static INTENSITY: Description = Description::new("1", "Intensity, white at 1");

/// Photograph in integers.
pub(crate) static PHOTOGRAPH: Description = Description::new("1", "Intensity, white at the largest sample");

/// Fused image in integers.
pub(crate) static FUSED: Description = Description::new(
    "1",
    "Best focus: of each pixel the sharpest photograph, at the pixels and in the values of the first (of a sweep, of the \
     reference frame); white at the largest sample, values beyond black and white clipped",
);

/// Fused image in floats.
pub(crate) static FUSED_FLOAT: Description = Description::new(
    "1",
    "Best focus: of each pixel the sharpest photograph, at the pixels and in the values of the first (of a sweep, of the \
     reference frame); white at 1, nothing clipped",
);

/// True depth of a synthetic pair.
pub(crate) static DEPTH: Description =
    Description::new("mm", "Depth in mm from the lens, at the pixels of the first image");

/// Depth of a pair with a lens, and its standard deviation.
pub(crate) static METRIC_DEPTH: Description = Description::new(
    "mm",
    "Y: depth in mm from the lens, at the pixels of the first image; standard_deviation: that of Y in mm, from the \
     uncertainty of the relative blur; NaN outside the valid region and the range of the lens model",
);

/// Depth of a sweep, and its standard deviation.
pub(crate) static SWEEP_DEPTH: Description = Description::new(
    "mm",
    "Y: depth in mm, from the lens or along the axis of the stage, at the pixels of the reference frame; \
     standard_deviation: that of Y in mm; NaN where no pair of frames determines it",
);

/// Profile.
pub(crate) static PROFILE: Description = Description::new("1", "Profile with one standard deviation to either side");

/// Pixels that are measured.
pub(crate) static VALID: Description = Description::new(
    "label",
    "255 where the relative blur V, or the focus of a sweep, is measured; 0 where it is not valid, masked, or filled in for \
     want of texture",
);

/// Labels of a pair.
pub(crate) static LABELS: Description = Description::new(
    "label",
    "Sharper photograph: 0 not valid; 1 the first; 2 the second; 3 undecided, the relative blur V is within one standard \
     deviation of 0: both alike, or nothing to tell by",
);

/// Labels of a sweep.
pub(crate) static SWEEP_LABELS: Description =
    Description::new("label", "The frame of the sweep that is focused next to each pixel, counted from 1; 0 not known");
