//! What may be asked of a solve, of one pair as of many: the options that `solve` and `batch` share.

use parfocal::Method;
use parfocal::image_io::RawFormat;

use crate::cli::commands::measure::MeasureArguments;
use crate::cli::jobs::request::Request;
use crate::cli::options::colors::ColorsArgument;
use crate::cli::options::headings::{INPUT, OUTPUT, REGISTRATION};
use crate::cli::options::lens::LensArguments;
use crate::cli::options::models::ModelArguments;
use crate::cli::options::run::RunArguments;
use crate::cli::options::scope::ScopeArguments;
use crate::cli::options::settings::{SettingsArguments, one_or_two};
use crate::cli::output::destination::ForceArgument;
use crate::cli::output::failure::Failure;

/// The options.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct SolveOptions {
    /// Which image is focused nearer [default: 1; with a lens, as its focus distances say]
    ///
    /// It decides which end of V is near in pictures and page.
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = one_or_two)]
    nearer: Option<u8>,
    #[command(flatten)]
    settings: SettingsArguments,
    /// How to register
    #[arg(long, value_name = "NAME", help_heading = REGISTRATION, value_enum,
          default_value_t)]
    method: Method,
    /// Keep what --transform states instead of starting from it; the method is then aligned
    #[arg(long, help_heading = REGISTRATION, requires_if("true", "transform"))]
    hold: bool,
    #[command(flatten)]
    scope: ScopeArguments,
    #[command(flatten)]
    lens: LensArguments,
    #[command(flatten)]
    measure: MeasureArguments,
    #[command(flatten)]
    colors: ColorsArgument,
    /// Do not write report.html
    #[arg(long, help_heading = OUTPUT)]
    no_html: bool,
    #[command(flatten)]
    models: ModelArguments,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    run: RunArguments,
}

impl SolveOptions {
    /// What photographs without a header hold, if they are that.
    pub(crate) fn raw(&self) -> Option<RawFormat> {
        self.settings.raw()
    }

    /// What they ask for, once it is found not to contradict itself.
    pub(crate) fn request(&self) -> Result<Request, Failure> {
        let part = self.scope.part();
        let files = self.settings.inputs().chain(self.lens.file()).chain(part.mask());
        let request = Request {
            files: files.cloned().collect(),
            settings: self.settings.settings(self.method, self.hold)?,
            raw: self.settings.raw().map(|raw| raw.to_string()),
            nearer: self.nearer,
            part,
            lens: self.lens.stated()?,
            wanted: self.measure.request(),
            palette: self.colors.palette(),
            page: !self.no_html,
            models: self.models.models(),
            force: self.force,
            run: self.run.clone(),
        };
        request.check()?;
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;
    use parfocal::{Photometric, Settings};

    use super::*;

    #[derive(Parser)]
    struct Only {
        #[command(flatten)]
        options: SolveOptions,
    }

    const T: &str = r#"{"tx_px": 3, "ty_px": 4, "rotation_deg": 0, "scale": 1}"#;

    fn with_exposure() -> String {
        format!(r#"{{"transform": {T}, "photometric": {{"gain": 1.2, "offset": 0.1}}}}"#)
    }

    fn request(flags: &[&str]) -> Result<Request, Failure> {
        Only::try_parse_from(["only"].iter().chain(flags)).unwrap().options.request()
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
    fn without_flags_the_settings_are_those_of_the_library() {
        assert_eq!(settings(&[]), Settings::default());
    }

    #[test]
    fn a_transform_is_a_start_and_hold_keeps_it() {
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
    fn an_exposure_by_flag_is_held_and_goes_before_a_file() {
        let found = settings(&["--gain", "1.1"]);
        assert_eq!((found.photometric, found.start_photometric), (false, Photometric { gain: 1.1, offset: 0.0 }));
        let found = with_file(&["--offset", "-0.02"], &with_exposure());
        assert_eq!((found.photometric, found.start_photometric), (false, Photometric { gain: 1.0, offset: -0.02 }));
        assert!(request(&["--gain", "0"]).is_err());
    }

    #[test]
    fn every_method_has_its_name() {
        for method in [Method::Unified, Method::Aligned, Method::Appearance, Method::Sift] {
            assert_eq!(settings(&["--method", method.name()]).method, method);
        }
    }

    #[test]
    fn the_digest_is_of_what_decides_the_results() {
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
