//! The options of the settings of a solve, generated from the library's table of settings.

use std::convert::Infallible;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::LazyLock;

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};
use parfocal::export::{REPORT_FILE, Registration};
use parfocal::image_io::RawFormat;
use parfocal::{
    Settings, image_io,
    internals::Setting,
    settings::{Kernel, Method, Motion, Photometric},
};
use serde_json::Value;

use crate::cli::help::{BLUR, INPUT, REGISTRATION};
use crate::cli::options::config_file::ConfigArgument;
use crate::cli::output::failure::Failure;

/// The options that set [`Settings`].
#[derive(Args, Clone, Debug)]
pub(crate) struct SettingsArguments {
    #[command(flatten)]
    table: TableArguments,
    /// Read frames without a header, of this format and size, as in Mono12p:2448x2048
    ///
    /// Formats: Mono8, Mono10, Mono12, Mono14, Mono16, Mono10p, Mono12p, Mono10Packed, Mono12Packed, Mono32f, RGB8,
    /// BGR8, RGBa8, BGRa8, RGB16, RGB32f, BayerRG8 and the other Bayer patterns, named as in GenICam and GigE Vision.
    /// In a folder, files that end with .raw or .bin are read.
    #[arg(long, value_name = "FORMAT:WxH", help_heading = INPUT)]
    raw: Option<RawFormat>,
    #[command(flatten)]
    config: ConfigArgument,
    /// Start from the registration in a report.json or its folder, or in a file that register wrote
    ///
    /// A file with a transform object alone is accepted too. If the file states the exposure, that is a start as well.
    #[arg(long, value_name = "FILE", help_heading = REGISTRATION, value_parser = registration_file)]
    transform: Option<PathBuf>,
    /// Keep the frames of a sweep that are blank, of another scene or merged from others, instead of leaving them out
    #[arg(long, help_heading = INPUT)]
    keep_frames: bool,
    /// Do not match the exposure (gain, offset and shading) of the two images
    #[arg(long, help_heading = REGISTRATION)]
    no_photometric: bool,
    /// Hold the gain, the factor on I2 that matches I1 (0.001 to 1000); with --offset, which is 0 if not given
    #[arg(long, value_name = "G", help_heading = REGISTRATION)]
    gain: Option<f64>,
    /// Hold the offset that is added after the gain, where white is 1
    #[arg(long, value_name = "O", help_heading = REGISTRATION)]
    offset: Option<f64>,
    /// Shape of the blur: auto, gaussian, pillbox, half-gaussian, or a picture
    ///
    /// auto finds whether it is a Gaussian or a disk, and how far the focus settings are apart. A picture can be that of a coded aperture.
    #[arg(long, value_name = "K|FILE", help_heading = BLUR, default_value = "auto")]
    kernel: KernelChoice,
}

/// The options in the table of settings; for `bench` those in [`BENCH`].
#[derive(Clone, Debug)]
pub(crate) struct TableArguments<const IS_BENCH: bool = false>(pub(crate) Settings);

/// The settings that `bench` takes.
const BENCH: [&str; 3] = ["max_relative_blur", "outer_iterations", "relaxation_sweeps"];

/// The long option and the default of each row of the table.
static TEXTS: LazyLock<Vec<[String; 2]>> = LazyLock::new(|| {
    let default = |setting: &Setting| match (setting.default)().as_str() {
        // As the placeholder of a switch has it.
        "true" => "on".to_string(),
        "false" => "off".to_string(),
        other => other.to_string(),
    };
    Settings::TABLE.iter().map(|setting| [setting.name.replace('_', "-"), default(setting)]).collect()
});

impl<const IS_BENCH: bool> TableArguments<IS_BENCH> {
    fn rows() -> impl Iterator<Item = (&'static Setting, &'static [String; 2])> {
        let is_option = |setting: &Setting| setting.flag.is_some() && (!IS_BENCH || BENCH.contains(&setting.name));
        Settings::TABLE.iter().zip(TEXTS.iter()).filter(move |(setting, _)| is_option(setting))
    }

    fn option((setting, [long, default]): (&'static Setting, &'static [String; 2])) -> Option<Arg> {
        let [heading, placeholder] = setting.flag?;
        let (first, details) = setting.doc.split_once('\n').unwrap_or((setting.doc, ""));
        let range = setting.range.map(|[low, high]| format!("{low} to {high}"));
        let limits: Vec<String> =
            Some(setting.unit.to_string()).filter(|unit| !unit.is_empty()).into_iter().chain(range).collect();
        let limits = if limits.is_empty() { String::new() } else { format!(" ({})", limits.join(", ")) };
        let help = format!("{}{limits}", first.trim().trim_end_matches('.'));
        let long_help = (!details.is_empty())
            .then(|| format!("{help}\n\n{}", details.lines().map(str::trim).collect::<Vec<_>>().join(" ")));
        let option = Arg::new(setting.name)
            .long(long.as_str())
            .value_name(placeholder)
            .help(help)
            .default_value(default.as_str())
            .allow_negative_numbers(true)
            .value_parser((setting.parser)());
        let option = if IS_BENCH { option } else { option.help_heading(heading) };
        Some(match long_help {
            Some(text) => option.long_help(text),
            None => option,
        })
    }
}

impl<const IS_BENCH: bool> Args for TableArguments<IS_BENCH> {
    fn augment_args(command: Command) -> Command {
        command.args(Self::rows().filter_map(Self::option))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<const IS_BENCH: bool> FromArgMatches for TableArguments<IS_BENCH> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut settings = Settings::default();
        for (setting, _) in Self::rows() {
            // The parser of the option has already accepted the text.
            if let Some(text) = matches.get_raw(setting.name).and_then(Iterator::last) {
                settings.set(setting.name, &text.to_string_lossy());
            }
        }
        Ok(Self(settings))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// A file with a registration. For a folder of results it is the report.
pub(crate) fn registration_file(text: &str) -> Result<PathBuf, Infallible> {
    let path = PathBuf::from(text);
    Ok(if path.is_dir() { path.join(REPORT_FILE) } else { path })
}

/// The near end of a sweep or a pair, by its number.
pub(crate) fn one_or_two(text: &str) -> Result<u8, String> {
    match text {
        "1" => Ok(1),
        "2" => Ok(2),
        _ => Err("give 1 or 2: which photograph is the one focused nearer, the first (I1) or the second (I2); of a sweep the \
                  first frame or the last"
            .to_string()),
    }
}

/// A kernel by name, or from a file.
#[derive(Clone, Debug)]
pub(crate) enum KernelChoice {
    Named(Kernel),
    File(PathBuf),
}

impl FromStr for KernelChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        let named = Kernel::NAMED.into_iter().find(|kernel| kernel.name() == text);
        Ok(named.map_or_else(|| Self::File(text.into()), Self::Named))
    }
}

impl KernelChoice {
    pub(crate) fn read(&self) -> Result<Kernel, Failure> {
        match self {
            Self::Named(kernel) => Ok(kernel.clone()),
            Self::File(path) if !path.exists() => Err(Failure::Usage(format!(
                "--kernel {}: neither auto, gaussian, pillbox nor half-gaussian, nor is there such a file",
                path.display()
            ))),
            Self::File(path) => Ok(image_io::read_kernel(path)?),
        }
    }
}

/// What the registration and exposure of `--transform` are used for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum StartUse {
    Start,
    Hold,
}

impl SettingsArguments {
    /// The settings of the options and of `--transform`.
    pub(crate) fn settings(&self, method: Method, start_use: StartUse) -> Result<Settings, Failure> {
        let exposure = self.exposure();
        let mut settings = Settings {
            method,
            photometric: !self.no_photometric && exposure.is_none(),
            start_photometric: exposure.unwrap_or_default(),
            keep_frames: self.keep_frames,
            ..self.table.0.clone()
        };
        if method == Method::Sift && settings.motion != Motion::Similarity {
            return Err(Failure::Usage("SIFT finds a similarity; leave out --motion or --method".to_string()));
        }
        settings.check()?;
        settings.kernel = self.kernel.read()?;
        self.start_from_file(start_use, &mut settings)?;
        Ok(settings)
    }

    /// The format of photographs without a header.
    pub(crate) fn raw(&self) -> Option<RawFormat> {
        self.raw
    }

    /// The exposure that the options hold.
    fn exposure(&self) -> Option<Photometric> {
        let Photometric { gain, offset } = Photometric::IDENTITY;
        let held = Photometric { gain: self.gain.unwrap_or(gain), offset: self.offset.unwrap_or(offset) };
        self.gain.or(self.offset).map(|_| held)
    }

    fn start_from_file(&self, start_use: StartUse, settings: &mut Settings) -> Result<(), Failure> {
        let Some(file) = &self.transform else { return Ok(()) };
        let hold = start_use == StartUse::Hold;
        let usage = |problem: &str| Err(Failure::Usage(problem.to_string()));
        match settings.method {
            Method::Appearance | Method::Sift if hold => {
                return usage("--hold keeps T, and this method would find another; leave out --hold or --method");
            }
            Method::Sift => return usage("SIFT starts from key-points, not from --transform; leave one of them out"),
            _ => {}
        }
        let registration = Registration::read(file)?;
        let Some(second) = registration.second() else {
            let problem = "registers a sweep; give the registration of a pair";
            return Err(Failure::file(file, problem));
        };
        settings.start = second.transform;
        if hold {
            settings.method = Method::Aligned;
        }
        if let (Some(start_photometric), None) = (second.photometric(), self.exposure()) {
            settings.start_photometric = start_photometric;
            // Only gain and offset can be held. With shading, all are matched again on the held T.
            let shaded = second.shading.is_some_and(|shading| shading.is_significant());
            settings.photometric &= !hold || shaded;
        }
        Ok(())
    }

    /// The files that are read in addition to photographs. No result may replace them.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &PathBuf> {
        let kernel = match &self.kernel {
            KernelChoice::File(path) => Some(path),
            KernelChoice::Named(_) => None,
        };
        self.transform.iter().chain(kernel).chain(self.config.file())
    }
}

/// Names of the settings that differ, including nested ones.
pub(crate) fn differing(a: &Value, b: &Value) -> Vec<(String, [Value; 2])> {
    let keys = |value: &Value| value.as_object().map(|map| map.keys().cloned().collect::<Vec<_>>()).unwrap_or_default();
    let mut names = keys(a);
    names.extend(keys(b).into_iter().filter(|key| a.get(key).is_none()));
    let of = |name: String| match (&a[&name], &b[&name]) {
        (x, y) if x == y => Vec::new(),
        (x, y) if x.is_object() && y.is_object() => {
            differing(x, y).into_iter().map(|(inner, both)| (format!("{name}.{inner}"), both)).collect()
        }
        (x, y) => vec![(name, [x.clone(), y.clone()])],
    };
    names.into_iter().flat_map(of).collect()
}
