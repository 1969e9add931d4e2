//! The judgement of a part against golden parts, for `inspect`, `batch` and `watch`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

use image::RgbImage;
use parfocal::export::{Destination, InspectReport, InspectedPart, write_inspection};
use parfocal::metric::inspect::{Heights, Limits, inspect};
use parfocal::page::inspection;
use parfocal::settings::Decode;
use parfocal::transform::{Brightness, Similarity};
use parfocal::{Region, resample};

use crate::cli::inspection::golden::{Combined, Field, Golden, Part, Placement};
use crate::cli::output::failure::{Failure, plain};

/// Golden parts and limits, by which parts are judged.
pub(crate) struct Judge {
    golden: Golden,
    limits: Limits,
    /// The regions of the golden part that are judged; all of it if there are none.
    regions: Vec<Region>,
    placement: Placement,
    /// For each quantity one golden part from all.
    combined: Vec<OnceLock<Result<Combined, Failure>>>,
    /// The serial number that first had what no other part has.
    known: Mutex<HashMap<String, String>>,
}

impl Judge {
    pub(crate) fn new(
        mut golden: Golden,
        limits: Limits,
        regions: &[Region],
        placement: Placement,
    ) -> Result<Self, Failure> {
        golden.restrict(regions)?;
        let combined = golden.fields.iter().map(|_| OnceLock::new()).collect();
        Ok(Self { golden, limits, regions: regions.to_vec(), placement, combined, known: Mutex::default() })
    }

    /// The folders of the golden parts, or the file of a taught one.
    pub(crate) fn golden(&self) -> &[String] {
        &self.golden.names
    }

    /// The tolerance and the other limits.
    pub(crate) fn limits(&self) -> &Limits {
        &self.limits
    }

    pub(crate) fn judge(&self, folder: &Path, label: InspectedPart) -> Result<Judged, Failure> {
        let (part, golden) = (Part::read(folder, self.limits.smallest_px.is_some())?, &self.golden);
        let mut faults: Vec<String> = part.doubt().into_iter().chain(self.frozen(&part, &label.serial)).collect();
        let (index, field) = self.common(&part)?;
        part.check(&golden.first)?;
        let of_golden = self.combined[index].get_or_init(|| golden.combined(field, &self.limits));
        let Combined { heights: combined, disagreeing } = of_golden.as_ref().map_err(Failure::clone)?;
        let transform = part.register(&golden.first, self.placement)?;
        let size = [combined.width, combined.height];
        let Some(own) = part.heights(&field.name, field.unit) else { return Err(self.nothing_common(&part)) };
        let heights = own.resample(size, &transform);
        let found = inspect(&heights, combined, &self.limits).map_err(|e| part.failed(&golden.first, e))?;
        faults.extend(self.misplaced(&part, &transform));
        let doubts = golden.doubts.iter().cloned().chain(disagreeing.clone()).collect();
        let quantity = (field.name.as_str(), field.unit);
        let mut report = InspectReport::new(
            (label, &golden.names),
            quantity,
            (self.limits, transform, &self.regions),
            (&found, size),
            [faults, doubts],
        );
        (report.placement, report.registration) = (golden.placement, golden.registration);
        let words = format!(
            "{}: tolerance {} {}, {} σ",
            report.verdict.text(),
            self.limits.tolerance,
            field.unit,
            self.limits.sigmas
        );
        let unchanged = Brightness::identity(size);
        let moved = resample::registered(&part.picture, &transform.into(), &unchanged, Decode::None);
        let picture = inspection::draw(&moved, &found, field.unit, &words);
        Ok(Judged { report, picture })
    }

    /// Says which earlier part has a photograph or the samples of this one, if there is one: then the camera, or what
    /// stores its photographs, stands still.
    fn frozen(&self, part: &Part, serial: &str) -> Option<String> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let mut first = |key: &String| known.entry(key.clone()).or_insert_with(|| serial.to_string()).clone();
        // All are entered.
        let all: Vec<String> = part.keys.iter().map(&mut first).collect();
        all.into_iter().find(|first| first != serial).map(|first| {
            let advice = "see whether the camera takes new ones, and take this part again";
            format!("a photograph is the same as one of {}: {advice}", plain(&first))
        })
    }

    /// Says by what a part lies out of the range that is stated or taught, and its photographs to each other.
    fn misplaced(&self, part: &Part, transform: &Similarity) -> Vec<String> {
        let golden = &self.golden;
        let found = match self.placement {
            Placement::Free => Some(*transform),
            Placement::Fixed if golden.placement.is_some() => part.lies(&golden.first).ok(),
            Placement::Fixed => None,
        };
        let lies = golden.placement.and_then(|range| match found {
            None => Some("the picture of the part is not that of the golden part: see whether it lies as good parts do".to_string()),
            Some(found) => range.problem(&found).map(|off| {
                format!("the part lies {off}; lay it as good parts lie, or state by --max-shift and --max-rotation how it may lie")
            }),
        });
        let pair = golden.registration.zip(part.pair).and_then(|(range, pair)| range.problem(&pair)).map(|off| {
            format!("the second photograph lies {off}, by those of good parts; see whether the registration is right")
        });
        lies.into_iter().chain(pair).collect()
    }

    /// The best quantity that the part and all golden parts have.
    fn common(&self, part: &Part) -> Result<(usize, &Field<Vec<Heights>>), Failure> {
        let fields = self.golden.fields.iter().enumerate().rev();
        let mut common = fields.filter(|(_, field)| part.heights(&field.name, field.unit).is_some());
        common.next().ok_or_else(|| self.nothing_common(part))
    }

    fn nothing_common(&self, part: &Part) -> Failure {
        let names: Vec<String> =
            self.golden.fields.iter().map(|field| format!("{} in {}", field.name, field.unit)).collect();
        Failure::Failed(format!(
            "{}: has no quantity in common with the golden parts, which have {}: solve it with their lens or focus \
             positions; pairs and sweeps cannot be compared",
            part.name,
            names.join(" and ")
        ))
    }
}

/// A judged part.
pub(crate) struct Judged {
    pub(crate) report: InspectReport,
    picture: RgbImage,
}

impl Judged {
    /// Writes inspect.json and inspect.png, both or none.
    pub(crate) fn write(&self, out: Destination<'_>) -> Result<(), Failure> {
        Ok(write_inspection(out, &self.report, &self.picture)?)
    }
}

/// The label of results in a folder whose photographs are not known: the name of the folder, and the time of
/// the report.
pub(crate) fn label_of(folder: &PathBuf) -> InspectedPart {
    let own = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.clone());
    let serial = own.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let changed = folder.join(parfocal::export::REPORT_FILE).metadata().and_then(|found| found.modified()).ok();
    let time = crate::cli::inspection::verdict::utc(changed.unwrap_or_else(std::time::SystemTime::now));
    InspectedPart { part: folder.display().to_string(), serial, time }
}
