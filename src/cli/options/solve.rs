//! The options that `solve`, `batch` and `watch` share, and the request that results from them.

use std::path::PathBuf;
use std::sync::Arc;

use parfocal::export::{MeasurementRequest, Nearer, Palette};
use parfocal::image_io::{Input, RawFormat};
use parfocal::settings::Method;
use parfocal::{Frame, Lens, Settings, internals::bounded_read};
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::cli::help::{INPUT, OUTPUT, REGISTRATION};
use crate::cli::options::exports::Exports;
use crate::cli::options::lens::{self, LensArguments, PartOfLens};
use crate::cli::options::part::{MeasureArguments, PixelSizeArgument, ScopeArguments, SolvedPart};
use crate::cli::options::run::{ColorsArgument, RunArguments};
use crate::cli::options::settings::{SettingsArguments, StartUse, one_or_two};
use crate::cli::output::destination::ForceArgument;
use crate::cli::output::failure::Failure;
use crate::cli::output::progress::Bar;

/// The options of a solve.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct SolveArguments {
    /// Image that is focused nearer [default: 1, or by the focus distances of the lens]
    ///
    /// Determines which end of V is near in the pictures and on the page.
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = one_or_two)]
    nearer: Option<u8>,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Registration method
    #[arg(long, value_name = "NAME", help_heading = REGISTRATION, value_enum,
          default_value_t)]
    method: Method,
    /// Hold the registration of --transform instead of starting from it; the method is then aligned
    #[arg(long, help_heading = REGISTRATION, requires_if("true", "transform"))]
    hold: bool,
    #[command(flatten)]
    scope: ScopeArguments,
    #[command(flatten)]
    lens: LensArguments,
    #[command(flatten)]
    results: ResultArguments,
}

/// The options of measurements, files and the run, which a pair and a sweep have in common.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct ResultArguments {
    #[command(flatten)]
    measure: MeasureArguments,
    #[command(flatten)]
    pixel: PixelSizeArgument,
    #[command(flatten)]
    colors: ColorsArgument,
    /// Do not write report.html
    #[arg(long, help_heading = OUTPUT)]
    no_html: bool,
    #[command(flatten)]
    models: Exports,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    run: RunArguments,
}

impl SolveArguments {
    /// The format of photographs without a header.
    pub(crate) fn raw(&self) -> Option<RawFormat> {
        self.settings.raw()
    }

    /// The request, or an error if options contradict each other.
    pub(crate) fn request(&self) -> Result<Request, Failure> {
        let start_use = if self.hold { StartUse::Hold } else { StartUse::Start };
        let settings = self.settings.settings(self.method, start_use)?;
        let mut request = self.results.request(&self.settings, settings, self.scope.part(), self.nearer)?;
        request.files.extend(self.lens.file().cloned());
        request.lens = self.lens.stated()?;
        request.check()?;
        Ok(request)
    }
}

impl ResultArguments {
    /// The request without a lens, or an error if options contradict each other.
    pub(crate) fn request(
        &self,
        arguments: &SettingsArguments,
        settings: Settings,
        part: SolvedPart,
        nearer: Option<u8>,
    ) -> Result<Request, Failure> {
        let request = Request {
            files: arguments.inputs().chain(part.mask()).cloned().collect(),
            settings,
            raw: arguments.raw().map(|raw| raw.to_string()),
            nearer,
            part,
            lens: None,
            wanted: self.measure.request(),
            pixel_size: self.pixel.pixel_size,
            palette: self.colors.palette(),
            page: !self.no_html,
            models: self.models.clone(),
            force: self.force,
            run: self.run.clone(),
        };
        request.check()?;
        Ok(request)
    }
}

/// Greatest size of a file that changes the results, 4 GiB, like that of a photograph.
const MAX_BYTES: u64 = 1 << 32;

/// Time to write a pixel of the results, s, without the page and with it: the metal part, two threads.
const WRITING: [f64; 2] = [0.13e-6, 0.34e-6];
/// Time to draw a pixel of a frame beyond the second on the page, s: 12 frames of the dimple, two threads.
const DRAWING: f64 = 0.015e-6;

/// The options for solving a pair or a sweep. The serialized fields are those that change the results.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Request {
    /// The settings, including the contents of the files for kernel and registration.
    pub(crate) settings: Settings,
    /// The format of photographs without a header.
    pub(crate) raw: Option<String>,
    /// The image that is focused nearer, 1 or 2, if stated.
    pub(crate) nearer: Option<u8>,
    pub(crate) part: SolvedPart,
    /// The stated fields of the lens. With a complete lens, depth in mm is computed.
    pub(crate) lens: Option<PartOfLens>,
    pub(crate) wanted: MeasurementRequest,
    /// The size of a pixel on the surface, µm.
    pub(crate) pixel_size: Option<f64>,
    pub(crate) palette: Palette,
    /// Whether report.html is written.
    pub(crate) page: bool,
    pub(crate) models: Exports,
    #[serde(skip)]
    pub(crate) force: ForceArgument,
    /// The files that are read in addition to photographs. No result may replace them.
    #[serde(skip)]
    pub(crate) files: Vec<PathBuf>,
    #[serde(skip)]
    pub(crate) run: RunArguments,
}

impl Request {
    /// Refuses options that contradict each other.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        self.nearer(self.lens.map_or(Ok(None), PartOfLens::if_whole)?.as_ref())?;
        if self.part.crop_valid && !self.wanted.is_empty() {
            let problem = "--crop-valid moves the pixels that --step and --profile name; measure afterwards, with parfocal measure";
            return Err(Failure::Usage(problem.to_string()));
        }
        Ok(())
    }

    /// A progress bar for the solve of these frames and the writing of its results.
    pub(crate) fn bar(&self, frames: &[Frame]) -> Arc<Bar> {
        let size = [frames[0].width(), frames[0].height()];
        let [width, height] = self.part.size(size).unwrap_or(size).map(f64::from);
        let drawn = if self.page { frames.len() - 2 } else { 0 };
        self.run.bar(width * height * (WRITING[usize::from(self.page)] + DRAWING * drawn as f64))
    }

    /// The image that is focused nearer, from `--nearer` and the lens.
    pub(crate) fn nearer(&self, lens: Option<&Lens>) -> Result<Nearer, Failure> {
        lens::nearer(self.nearer, lens)
    }

    /// The lens. Fields that are not stated are taken from the photographs.
    pub(crate) fn lens(&self, photographs: &[Input]) -> Result<Option<Lens>, Failure> {
        self.lens.map(|stated| stated.or(PartOfLens::of_photographs(photographs)).whole()).transpose()
    }

    /// SHA-256 of everything that changes the results, except the photographs: the version, the request, its files, and
    /// `more`, the parts that only a sweep has.
    pub(crate) fn digest(&self, more: &[u8]) -> Result<String, Failure> {
        let request = serde_json::to_vec(self).map_err(|e| Failure::Failed(e.to_string()))?;
        let read = |file: PathBuf| {
            let failed = |e| Failure::file(&file, format!("cannot be read ({e}); check its permissions"));
            bounded_read::read(&file, MAX_BYTES).map_err(failed)
        };
        let files = self.part.files().into_iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let mut digest = Sha256::new();
        let more = (!more.is_empty()).then(|| more.to_vec());
        for part in [env!("CARGO_PKG_VERSION").into(), request].into_iter().chain(files).chain(more) {
            // The length is included, so that different lists of parts have different digests.
            digest.update(part.len().to_le_bytes());
            digest.update(part);
        }
        Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use parfocal::{Settings, settings::Photometric};

    use super::*;
    use crate::cli::options::run::parsed;

    const T: &str = r#"{"tx_px": 3, "ty_px": 4, "rotation_deg": 0, "scale": 1}"#;

    fn with_exposure() -> String {
        format!(r#"{{"transform": {T}, "gain": 1.2, "offset": 0.1}}"#)
    }

    fn request(flags: &[&str]) -> Result<Request, Failure> {
        parsed::<SolveArguments>(flags).request()
    }

    fn settings(flags: &[&str]) -> Settings {
        request(flags).unwrap().settings
    }

    fn with_file(flags: &[&str], json: &str) -> Settings {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("report.json");
        fs::write(&file, json).unwrap();
        settings(&[&["--transform", file.to_str().unwrap()], flags].concat())
    }

    #[test]
    fn the_default_flags_are_the_default_settings() {
        assert_eq!(settings(&[]), Settings::default());
    }

    #[test]
    fn a_transform_is_a_start_and_hold_fixes_it() {
        let start = with_file(&[], &with_exposure());
        assert_eq!((start.method, start.photometric, start.start.translation()[0]), (Method::Unified, true, 3.0));
        assert_eq!(start.start_photometric.gain, 1.2);
        let held = with_file(&["--hold"], &with_exposure());
        assert_eq!((held.method, held.photometric, held.start.translation()[1]), (Method::Aligned, false, 4.0));
        let exposure_not_stated = with_file(&["--hold"], T);
        assert_eq!((exposure_not_stated.method, exposure_not_stated.photometric), (Method::Aligned, true));
        let aligned = with_file(&["--method", "aligned"], &with_exposure());
        assert_eq!((aligned.method, aligned.photometric, aligned.start.translation()[0]), (Method::Aligned, true, 3.0));
    }

    #[test]
    fn an_exposure_option_is_held_and_overrides_a_file() {
        let found = settings(&["--gain", "1.1"]);
        assert_eq!((found.photometric, found.start_photometric), (false, Photometric { gain: 1.1, offset: 0.0 }));
        let found = with_file(&["--offset=-0.02"], &with_exposure());
        assert_eq!((found.photometric, found.start_photometric), (false, Photometric { gain: 1.0, offset: -0.02 }));
        assert!(request(&["--gain", "0"]).is_err());
    }

    #[test]
    fn each_method_is_chosen_by_its_name() {
        for method in [Method::Unified, Method::Aligned, Method::Appearance, Method::Sift] {
            assert_eq!(settings(&["--method", method.name()]).method, method);
        }
    }

    #[test]
    fn options_that_change_the_results_change_the_digest() {
        let mask = tempfile::NamedTempFile::new().unwrap();
        let digest = |flags: &[&str]| request(flags).unwrap().digest(&[]).unwrap();
        let masked = ["--mask", mask.path().to_str().unwrap()];
        let plain = digest(&[]);
        assert_eq!(plain, digest(&["--device", "0", "--timeout", "9", "--json", "-q", "--strict", "--force"]));
        let other: &[&[&str]] = &[
            &["--relaxation-sweeps", "6"],
            &["--decode", "srgb"],
            &["--nearer", "1"],
            &["--roi", "0,0,9,9"],
            &["--kappa", "0.4"],
            &["--profile", "0,0,9,9"],
            &["--pixel-size", "4.5"],
            &["--colors", "grey"],
            &["--no-html"],
            &["--export", "ply"],
            &masked,
        ];
        let mut seen: Vec<String> = other.iter().map(|flags| digest(flags)).chain([plain]).collect();
        let missing = request(&["--mask", "/nowhere/mask.png"]).unwrap().digest(&[]).unwrap_err().message();
        assert!(missing.starts_with("/nowhere/mask.png: cannot be read"), "{missing}");
        fs::write(mask.path(), "other").unwrap();
        seen.push(digest(&masked));
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), other.len() + 2);
    }
}
