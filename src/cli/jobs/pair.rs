//! A pair of photographs: from its files to its results.

use std::path::PathBuf;

use parfocal::export::{self, Kind, NearerBy, Report, Results};
use parfocal::image_io::{Input, Photograph, Values};
use parfocal::{Frame, Lens, PairSolver, Settings, Solution, SolveOptions, settings::DeviceInfo};

use crate::cli::jobs::results::{Expected, check_inputs, check_results, fitting, write_results};
use crate::cli::options::photographs;
use crate::cli::options::run::is_validation_requested;
use crate::cli::options::series;
use crate::cli::options::solve::Request;
use crate::cli::output::destination::same_file;
use crate::cli::output::failure::Failure;

/// The files of a pair, and the folder for its results.
#[derive(Clone, Debug)]
pub(crate) struct PairJob {
    pub(crate) files: [PathBuf; 2],
    pub(crate) out: PathBuf,
}

/// A pair as read from its files.
pub(crate) struct Photographs {
    pub(crate) frames: [Frame; 2],
    pub(crate) inputs: Vec<Input>,
    pub(crate) scope: SolveOptions,
    /// The settings, with the decoding resolved.
    pub(crate) settings: Settings,
    values: Values,
    lens: Option<Lens>,
}

impl PairJob {
    /// Refuses an output folder that cannot be written, or where a result would replace an input.
    pub(crate) fn check(&self, request: &Request) -> Result<(), Failure> {
        if request.part.flat.as_ref().is_some_and(|flat| same_file(flat, &self.out)) {
            let problem = "holds the flat reference; give another folder for the results";
            return Err(Failure::file(&self.out, problem));
        }
        check_inputs(request, &self.files, &self.out)?;
        check_results(request, Expected { kind: Kind::Pair, in_mm: request.lens.is_some() }, &self.out, &[])
    }

    /// Reads the pair. Returns `None` if `settled` finds complete results of these files. Checks large photographs
    /// against the device before decoding them.
    pub(crate) fn read(
        &self,
        request: &Request,
        settled: impl FnOnce(&[Input]) -> Result<bool, Failure>,
        device: impl FnOnce() -> Result<DeviceInfo, Failure>,
    ) -> Result<Option<Photographs>, Failure> {
        let (photographs, inputs) = photographs::open_pair(&self.files)?;
        if settled(&inputs)? {
            return Ok(None);
        }
        if request.part.is_whole() {
            photographs::check_size(photographs.each_ref(), &request.settings, PairSolver::MOST_PIXELS, device)?;
        }
        let lens = request.lens(&inputs)?;
        request.nearer(lens.as_ref())?;
        let values = Values::of(request.settings.decode, &inputs)?;
        let mut frames = Photograph::decode_pair(photographs)?;
        let values = values.corrected(&inputs, &mut frames);
        let settings = Settings { decode: values.decode, ..request.settings.clone() };
        let expected = Expected { kind: Kind::Pair, in_mm: lens.is_some() };
        let scope = fitting(request, expected, &self.out, &frames)?;
        Ok(Some(Photographs { frames, inputs, scope, settings, values, lens }))
    }

    /// Writes the results. Returns their report.
    pub(crate) fn write(
        &self,
        request: &Request,
        device: &DeviceInfo,
        photographs: &Photographs,
        solution: &Solution,
    ) -> Result<Report, Failure> {
        let nearer = request.nearer(photographs.lens.as_ref())?;
        let mut report = Report::pair(solution, &photographs.settings, device, nearer);
        report.values = photographs.values;
        report.set_inputs(photographs.inputs.clone());
        report.validated = is_validation_requested();
        report.flattened = photographs.scope.flat.is_some();
        report.request_sha256 = request.digest(&[])?;
        if request.nearer.is_some() {
            report.nearer_by = Some(NearerBy::Stated);
        }
        let depths = photographs.frames.each_ref().map(|frame| frame.format().depth);
        let mut results = Results::of_pair(solution, report, depths)?;
        if let Some(limit) = request.part.max_uncertainty {
            results.set_max_uncertainty(limit);
        }
        if let Some(lens) = &photographs.lens {
            results.set_lens(lens);
        }
        // V before the subtraction of the flat reference determines which photograph is sharper.
        let sharpness = photographs.scope.flat.as_ref().map(|flat| flat.restored(solution));
        let labels = request.models.is_labels().then(|| export::labels(sharpness.as_ref().unwrap_or(solution)));
        let names = self.files.iter().map(|file| series::file_name(file)).collect();
        write_results(request, &self.out, results, photographs.frames.iter().collect(), names, labels)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::cli::options::run::parsed;
    use crate::cli::options::solve::SolveArguments;

    #[test]
    fn hash_and_pixels_come_from_one_file_even_if_it_is_replaced() {
        let folder = tempfile::TempDir::new().unwrap();
        let [file, new] = ["a.pgm", "new.pgm"].map(|name| folder.path().join(name));
        fs::write(&file, b"P5 2 1 255 \x01\x02").unwrap();
        let request = parsed::<SolveArguments>(&[]).request().unwrap();
        let job = PairJob { files: [file.clone(), file.clone()], out: folder.path().join("out") };
        let no_device = || panic!("so small a pair fits any");
        let whole = job.read(&request, |_| Ok(false), no_device).unwrap().unwrap();
        let swap = |_: &[Input]| {
            fs::write(&new, b"P5 1 2 255 \x03\x04").unwrap();
            fs::rename(&new, &file).unwrap();
            Ok(false)
        };
        let swapped = job.read(&request, swap, no_device);
        let swapped = swapped.unwrap().unwrap();
        assert_eq!((swapped.frames, swapped.inputs), (whole.frames, whole.inputs));
        assert_eq!(job.read(&request, |_| Ok(false), no_device).unwrap().unwrap().frames[0].height(), 2);
    }
}
