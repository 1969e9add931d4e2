//! Golden parts: those of folders, or the taught one of a file.

use std::path::{Path, PathBuf};

use parfocal::export::{FUSED_FILE, GoldenPart, Kind, Report, Results};
use parfocal::internals::{key_points, median};
use parfocal::metric::inspect::golden::{Disagreement, disagreement, golden};
use parfocal::metric::inspect::{Heights, Limits, PlacementRange};
use parfocal::metric::response::{Detail, Smoothing};
use parfocal::settings::Decode;
use parfocal::transform::Similarity;
use parfocal::{Error, Frame, Region};
use serde_json::Value;

use crate::cli::options::settings::differing;
use crate::cli::output::failure::Failure;

/// A quantity with its name, its unit, and heights towards the camera.
pub(crate) struct Field<H> {
    pub(crate) name: String,
    pub(crate) unit: &'static str,
    pub(crate) heights: H,
}

/// Whether the fixture holds every part in the same position.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Placement {
    Fixed,
    /// The pictures are registered.
    Free,
}

/// A part that was read from its folder.
pub(crate) struct Part {
    /// The name for messages: the folder, or the file of a taught golden part.
    pub(crate) name: String,
    /// Whether its solve converged; `None` for a sweep.
    converged: Option<bool>,
    /// The settings that its heights depend on.
    pub(crate) settings: Value,
    /// The fused image, used to register the part.
    pub(crate) picture: Frame,
    /// The quantities; the best one is last.
    pub(crate) fields: Vec<Field<Heights>>,
    /// T of a pair: how its photographs lie to each other.
    pub(crate) pair: Option<Similarity>,
    /// What no other part has: the hashes of its photographs, and that of its fused image, which is the same for files
    /// of the same samples.
    pub(crate) keys: Vec<String>,
}

impl Part {
    /// Reads the results of a pair or a sweep, if they are as the solve wrote them.
    /// With `resolves` it states which detail of V they resolve.
    pub(crate) fn read(folder: &Path, resolves: bool) -> Result<Self, Failure> {
        let results = Results::read(folder)?;
        results.check_hashes()?;
        let evidence = results.evidence()?;
        let detail = if resolves { results.detail()? } else { None };
        let quantities = results.comparable();
        let of_blur = quantities.first().map(|blur| blur.deviation.clone()).unwrap_or_default();
        let fields = quantities.into_iter().map(|quantity| {
            let heights = quantity.heights(results.report.size.into())?;
            let heights = match &evidence {
                Some(evidence) => heights.with_evidence(evidence.clone())?,
                None => heights,
            };
            let ratios = of_blur.iter().zip(&*quantity.deviation).map(|(blur, own)| f64::from(blur / own));
            let heights = match (&detail, median(ratios)) {
                (Some(detail), Some(px2_per_height)) => {
                    let smoothing = Smoothing { px2_per_height, ..detail.smoothing };
                    heights.with_detail(Detail { smoothing, ..detail.clone() })?
                }
                _ => heights,
            };
            Ok(Field { name: quantity.label(), unit: quantity.unit, heights })
        });
        let fields = fields.collect::<Result<_, Failure>>()?;
        let report = &results.report;
        let (converged, settings) = (report.converged, settings(report)?);
        let pair = report.frames.get(1).filter(|_| report.kind == Kind::Pair).map(|frame| frame.transform.at_centre());
        let inputs = report.inputs.iter().map(|input| format!("{}#{}", input.sha256, input.page.unwrap_or(1)));
        let fused = report.hashes.get(FUSED_FILE).map(|hash| hash.sha256.clone());
        let keys = inputs.chain(fused).collect();
        Ok(Self {
            name: folder.display().to_string(),
            converged,
            settings,
            picture: results.fused()?,
            fields,
            pair,
            keys,
        })
    }

    /// Why its heights should not be believed, if there is a reason.
    pub(crate) fn doubt(&self) -> Option<String> {
        (self.converged == Some(false)).then(|| format!("the solve of {} had not converged", self.name))
    }

    /// Refuses other settings and another size than those of the golden part, since then heights differ for another
    /// reason than the part.
    pub(crate) fn check(&self, golden: &Self) -> Result<(), Failure> {
        let size = |part: &Self| [part.picture.width(), part.picture.height()];
        let ([w, h], [width, height]) = (size(self), size(golden));
        if [w, h] != [width, height] {
            let problem = format!("are of {w}x{h} and {width}x{height} pixels; solve the same part");
            return Err(self.failed(golden, problem));
        }
        let differing = differing(&self.settings, &golden.settings);
        if differing.is_empty() {
            return Ok(());
        }
        let each = differing.iter().map(|(name, [own, golden])| format!("{name} is {own} and {golden}"));
        let all = each.collect::<Vec<_>>().join(", ");
        Err(self.failed(golden, format!("have other settings: {all}; solve both with the same settings")))
    }

    /// The transform T from the golden part's pixels to its own.
    pub(crate) fn register(&self, golden: &Self, placement: Placement) -> Result<Similarity, Failure> {
        if placement == Placement::Fixed {
            return Ok(Similarity::IDENTITY);
        }
        self.lies(golden).map_err(|e| self.failed(golden, format!("{e}; --in-place takes the pictures as they lie")))
    }

    /// How it lies in its picture, by key-points.
    pub(crate) fn lies(&self, golden: &Self) -> Result<Similarity, Error> {
        if self.name == golden.name {
            return Ok(Similarity::IDENTITY);
        }
        key_points([&golden.picture, &self.picture], Decode::None, None)
    }

    /// The heights of a quantity; `None` if the part does not have it in this unit.
    pub(crate) fn heights(&self, name: &str, unit: &str) -> Option<&Heights> {
        self.fields.iter().find(|field| (field.name.as_str(), field.unit) == (name, unit)).map(|field| &field.heights)
    }

    /// An error that names both parts.
    pub(crate) fn failed(&self, other: &Self, problem: impl std::fmt::Display) -> Failure {
        Failure::Failed(format!("{} and {}: {problem}", self.name, other.name))
    }
}

/// One golden part from all.
pub(crate) struct Combined {
    pub(crate) heights: Heights,
    /// Which golden part disagrees with the others, as a sentence.
    pub(crate) disagreeing: Option<String>,
}

/// Golden parts on the pixels of the first.
pub(crate) struct Golden {
    /// The names of all, for messages.
    pub(crate) names: Vec<String>,
    /// The first, or the taught one.
    pub(crate) first: Part,
    /// The quantities that all have, with the heights of each golden part.
    pub(crate) fields: Vec<Field<Vec<Heights>>>,
    /// Why they should not be believed, one sentence each.
    pub(crate) doubts: Vec<String>,
    /// The tolerance that a golden part was taught with.
    tolerance: Option<f64>,
    /// How parts may lie on the picture of the first, if good parts have taught it.
    pub(crate) placement: Option<PlacementRange>,
    /// How the two photographs of a part may lie to each other.
    pub(crate) registration: Option<PlacementRange>,
}

impl Golden {
    /// Reads golden parts, and registers them onto the first. With `resolves` they state which detail of V they resolve.
    pub(crate) fn of_folders(folders: &[PathBuf], placement: Placement, resolves: bool) -> Result<Self, Failure> {
        let mut parts = folders.iter().map(|folder| Part::read(folder, resolves)).collect::<Result<Vec<_>, _>>()?;
        let Some(first) = parts.first() else {
            return Err(Failure::Usage("no golden part was given; name folders of results".to_string()));
        };
        let mut fields: Vec<Field<Vec<Heights>>> =
            first.fields.iter().map(|f| Field { name: f.name.clone(), unit: f.unit, heights: Vec::new() }).collect();
        fields.retain(|field| parts.iter().all(|part| part.heights(&field.name, field.unit).is_some()));
        if fields.is_empty() {
            let problem = "have no quantity in common: pairs and sweeps cannot be compared, nor settings of two units";
            return Err(parts.last().map_or(first, |last| last).failed(first, problem));
        }
        let mut lies = Vec::new();
        for part in &parts {
            part.check(first)?;
            let transform = part.register(first, placement)?;
            // Parts that are held in place have key-points in common, or their pictures say nothing about how they lie.
            lies.extend(match placement {
                Placement::Free => Some(transform),
                Placement::Fixed => (parts.len() > 2).then(|| part.lies(first).ok()).flatten(),
            });
            for field in &mut fields {
                let heights = part.heights(&field.name, field.unit).into_iter();
                let size = |heights: &Heights| [heights.width, heights.height];
                field.heights.extend(heights.map(|heights| heights.resample(size(heights), &transform)));
            }
        }
        let names = parts.iter().map(|part| part.name.clone()).collect();
        let doubts = parts.iter().filter_map(Part::doubt).collect();
        let size = [first.picture.width(), first.picture.height()];
        let pairs: Vec<Similarity> = parts.iter().filter_map(|part| part.pair).collect();
        let taught = |all: &[Similarity]| PlacementRange::taught(all, size).filter(|_| all.len() == parts.len());
        let (placement, registration) = (taught(&lies), taught(&pairs));
        Ok(Self { names, first: parts.swap_remove(0), fields, doubts, tolerance: None, placement, registration })
    }

    pub(crate) fn taught(file: &Path, GoldenPart { report, heights, picture }: GoldenPart) -> Self {
        let (name, tolerance) = (file.display().to_string(), report.tolerance);
        // The reader checks the unit.
        let unit = report.known_unit().unwrap_or_default();
        let field = Field { name: report.quantity, unit, heights: vec![heights] };
        let (placement, registration) = (report.placement, report.registration);
        let first = Part {
            name: name.clone(),
            converged: None,
            settings: report.settings,
            picture,
            fields: Vec::new(),
            pair: None,
            keys: Vec::new(),
        };
        Self {
            names: vec![name],
            first,
            fields: vec![field],
            doubts: Vec::new(),
            tolerance: Some(tolerance),
            placement,
            registration,
        }
    }

    /// The name of the first, or of the file.
    pub(crate) fn name(&self) -> &str {
        &self.first.name
    }

    /// The tolerance that a golden part was taught with; `None` for folders.
    pub(crate) fn tolerance(&self) -> Option<f64> {
        self.tolerance
    }

    /// Leaves out the heights outside of these regions.
    pub(crate) fn restrict(&mut self, regions: &[Region]) -> Result<(), Failure> {
        for field in &mut self.fields {
            let heights = std::mem::take(&mut field.heights).into_iter().map(|heights| heights.within(regions));
            field.heights =
                heights.collect::<Result<_, _>>().map_err(|e| Failure::Usage(format!("--inspect-roi: {e}")))?;
        }
        Ok(())
    }

    /// One golden part from all, and which of them disagrees with the others.
    pub(crate) fn combined(&self, field: &Field<Vec<Heights>>, limits: &Limits) -> Result<Combined, Failure> {
        let disagreeing = disagreement(&field.heights, limits)?.map(|found| self.disagrees(&found, field.unit));
        Ok(Combined { heights: golden(&field.heights, limits)?, disagreeing })
    }

    /// Which golden part disagrees with the others.
    fn disagrees(&self, found: &Disagreement, unit: &str) -> String {
        let ([x, y], extreme) = (found.deviation.centroid_px, found.deviation.extreme);
        let place = format!("at {x:.0},{y:.0} by {extreme:+.4} {unit}");
        match self.names.as_slice() {
            [first, second] => {
                format!(
                    "the golden parts {first} and {second} disagree {place}; with a third one, the bad one is known"
                )
            }
            all => {
                let folder = all.get(found.part).cloned().unwrap_or_default();
                format!("the golden part {folder} disagrees with the others {place}; leave it out, or solve it again")
            }
        }
    }
}

/// Settings that change how a solve arrives at its result, and not the result of one that converged.
const SOLVER_PATH_SETTINGS: [&str; 9] = [
    "start",
    "start_photometric",
    "registration_step",
    "levels",
    "outer_iterations",
    "relaxation_sweeps",
    "over_relaxation",
    "continuation",
    "largest_step",
];

/// The settings that the heights of results depend on. For a sweep whose focus is in settings, they include the number
/// of frames, since one setting is the distance between two frames.
fn settings(report: &Report) -> Result<Value, Failure> {
    let failed = |e: serde_json::Error| Failure::Failed(e.to_string());
    let mut settings = serde_json::to_value(&report.settings).map_err(failed)?;
    if let Some(map) = settings.as_object_mut() {
        map.retain(|name, _| !SOLVER_PATH_SETTINGS.contains(&name.as_str()));
        // As found, since `auto` may find another curve for each part.
        map.insert("decode".to_string(), serde_json::to_value(report.values.decode).map_err(failed)?);
        map.insert("flattened".to_string(), report.flattened.into());
        if report.focus_unit.as_deref() == Some("settings") {
            map.insert("number of frames".to_string(), report.frames.len().into());
        }
    }
    Ok(settings)
}
