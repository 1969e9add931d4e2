//! Where the frames of a sweep lie, as JSON, and read again.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::results::read_report;
use super::sweep::SweepFrame;
use super::transform::startable;
use super::{Destination, FileKind, ShadingReport, SizeReport, write_json};
use crate::base::{Brightness, Decode, Error, Homography, Photometric, Region};
use crate::files::image_io::{Input, Values};
use crate::solve::sweep::RegisteredSweep;

/// The registration of the frames of a sweep; fields named as in its [`SweepReport`](super::SweepReport).
#[derive(Clone, Debug, Serialize)]
pub struct SweepRegistration {
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// The frames in the order of their focus.
    pub frames: Vec<SweepFrame>,
    /// Which of the files that were given each of them is, from 0.
    pub order: Vec<usize>,
    /// The frame on whose pixels the others are brought, from 0.
    pub reference: usize,
    /// Size of the frames, about whose centre the transforms are stated.
    pub photograph: SizeReport,
    /// How stored values became intensities.
    pub decode: Decode,
    /// The same, and on whose word.
    pub values: Values,
    /// What the user should know; a sentence each.
    pub warnings: Vec<String>,
    /// The files of the frames; empty where they did not come from files.
    pub inputs: Vec<Input>,
    /// From the first frame to the registration, ms.
    pub total_ms: f64,
}

impl SweepRegistration {
    /// Of frames of these files, in the order in which they were given.
    pub fn new(found: &RegisteredSweep, files: &[String], total_ms: f64) -> Self {
        let [width, height] = found.photograph;
        Self {
            version: env!("CARGO_PKG_VERSION"),
            frames: SweepFrame::of(found, files),
            order: found.order.clone(),
            reference: found.reference,
            photograph: SizeReport { width, height },
            decode: found.decode,
            values: Values::stated(found.decode),
            warnings: found.warnings.clone(),
            inputs: Vec::new(),
            total_ms,
        }
    }
}

/// Writes it into a file; an earlier registration is replaced, another file only where the [`Destination`] forces it.
///
/// # Errors
/// [`Error::File`].
pub fn write_sweep_registration<'d>(
    file: impl Into<Destination<'d>>,
    registration: &SweepRegistration,
) -> Result<(), Error> {
    write_json(file, FileKind::Registration, registration)
}

/// Where the frames of a sweep lie, from a file.
#[derive(Clone, Debug)]
pub struct SweepPlaces {
    /// Of each frame, in the order in which their files were given: where each pixel of the reference lies in it, and what brings it to the reference's
    /// brightness.
    pub frames: Vec<(Homography, Brightness)>,
    /// The reference, from 0.
    pub reference: usize,
    /// Width and height of the frames.
    pub size: [u32; 2],
    /// The part of the reference that the results are of.
    pub region: Option<Region>,
    /// How stored values became intensities.
    pub decode: Decode,
}

#[derive(Deserialize)]
struct Stated {
    frames: Vec<Frame>,
    /// Absent from reports of earlier versions, whose frames were taken as given.
    order: Option<Vec<usize>>,
    reference: usize,
    photograph: Option<SizeReport>,
    size: Option<SizeReport>,
    region: Option<Region>,
    decode: Decode,
}

#[derive(Deserialize)]
struct Frame {
    transform: Homography,
    photometric: Photometric,
    shading: ShadingReport,
}

/// Reads what `parfocal register` found of a sweep, or the report of one; `None` where the file states no frames, and may be
/// of a pair.
///
/// # Errors
/// [`Error::File`]: it cannot be read, or a value is out of range.
pub fn read_sweep_places(path: &Path) -> Result<Option<SweepPlaces>, Error> {
    // What is wrong with a file of neither kind, `read_transform` says.
    let Ok(report) = read_report(path) else { return Ok(None) };
    if !report.get("frames").is_some_and(serde_json::Value::is_array) {
        return Ok(None);
    }
    let wrong = |problem: String| Error::file(path, format!("states no registration of a sweep ({problem})"));
    let stated = Stated::deserialize(&report).map_err(|e| wrong(e.to_string()))?;
    let Some(SizeReport { width, height }) = stated.photograph.or(stated.size) else {
        return Err(wrong("no size of the frames".to_string()));
    };
    if stated.reference >= stated.frames.len() {
        return Err(wrong(format!("{} frames, the reference {}", stated.frames.len(), stated.reference)));
    }
    let places = stated.frames.iter().map(|frame| {
        startable(frame.transform, Some(frame.photometric)).map_err(wrong)?;
        Ok((frame.transform, frame.shading.with(frame.photometric)))
    });
    let mut places = places.collect::<Result<Vec<_>, Error>>()?;
    let mut reference = stated.reference;
    if let Some(order) = stated.order.filter(|order| order.len() == places.len()) {
        let mut given: Vec<usize> = (0..order.len()).collect();
        given.sort_by_key(|n| order[*n]);
        places = given.iter().map(|n| places[*n]).collect();
        reference = given.iter().position(|n| *n == reference).unwrap_or(reference);
    }
    Ok(Some(SweepPlaces {
        frames: places,
        reference,
        size: [width, height],
        region: stated.region,
        decode: stated.decode,
    }))
}
