//! The settings of a solve.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use clap::ValueEnum;
use parfocal::image_io::{Input, RawFormat, Values};
use parfocal::export::Registration;
use parfocal::{Decode, Kernel, Method, Motion, Photometric, RegistrationStep, Settings, image_io};
use serde::Serialize;

use crate::cli::batch::batch_summary::REPORT;
use crate::cli::options::config_file::ConfigArgument;
use crate::cli::options::headings::{BLUR, INPUT, REGISTRATION};
use crate::cli::options::tuning::TuningArguments;
use crate::cli::output::failure::Failure;

/// The settings.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct SettingsArguments {
    /// How stored values become intensities
    #[arg(long, value_name = "HOW", help_heading = INPUT, value_enum, default_value_t = DecodeName::Auto)]
    decode: DecodeName,
    /// The photographs are frames without a header, of this format and size, as in Mono12p:2448x2048
    ///
    /// Mono8, Mono10, Mono12, Mono14, Mono16, Mono10p, Mono12p, Mono10Packed, Mono12Packed, Mono32f, RGB8, BGR8, RGBa8, BGRa8, RGB16,
    /// RGB32f, BayerRG8 and others of Bayer's patterns, as GenICam and GigE Vision name them. In a folder files that
    /// end with .raw or .bin are then taken.
    #[arg(long, value_name = "FORMAT:WxH", help_heading = INPUT)]
    raw: Option<RawFormat>,
    #[command(flatten)]
    config: ConfigArgument,
    /// Start from the registration in a report.json or its folder, or in what register wrote
    ///
    /// Or in a transform object alone; if the exposure is stated there, that too is a start.
    #[arg(long, value_name = "FILE", help_heading = REGISTRATION, value_parser = registration)]
    transform: Option<PathBuf>,
    /// What T may be; the summary says when a simpler one explains as much or a richer one more
    #[arg(long, value_name = "MODEL", help_heading = REGISTRATION, value_enum,
          default_value_t = MotionName::from(Settings::default().motion))]
    motion: MotionName,
    /// How the registration steps; gradient-descent is the paper's scheme, to compare with
    #[arg(long, value_name = "STEP", alias = "registration", help_heading = REGISTRATION, value_enum,
          default_value_t = StepName::from(Settings::default().registration))]
    registration_step: StepName,
    /// Do not match the difference in exposure (gain and offset) of the two images
    #[arg(long, help_heading = REGISTRATION)]
    no_photometric: bool,
    /// Hold the exposure: the factor on I2's values that makes them I1's, 0.001 to 1000; with --offset, which is 0 if not given
    #[arg(long, value_name = "G", help_heading = REGISTRATION, allow_negative_numbers = true)]
    gain: Option<f64>,
    /// Hold the exposure: what is added after the gain, where white is 1
    #[arg(long, value_name = "O", help_heading = REGISTRATION, allow_negative_numbers = true)]
    offset: Option<f64>,
    /// Pyramid levels, 1 to 12; auto halves the images while the short side stays at least 32 px
    #[arg(long, value_name = "N|auto", help_heading = BLUR, default_value_t = Auto(Settings::default().levels))]
    levels: Auto<u32>,
    /// Largest |V|, px², 1 to 256; more where pixels are at the limit
    ///
    /// V is the difference of the blurs' variances, px² of the full-size image.
    #[arg(long, value_name = "PX2", help_heading = BLUR, allow_negative_numbers = true,
          default_value_t = Settings::default().max_relative_blur)]
    max_relative_blur: f64,
    /// Smoothness of V, 1e-6 to 10; less shows more relief and more noise
    ///
    /// The weight α of the smoothness, which has no unit. What auto found is in the report.
    #[arg(long, value_name = "A|auto", help_heading = BLUR, allow_negative_numbers = true,
          default_value_t = Auto(Settings::default().regularization))]
    regularization: Auto<f64>,
    /// Iterations a level at most, 5 to 1000; a level stops once it has settled
    #[arg(long, value_name = "N", help_heading = BLUR, default_value_t = Settings::default().outer_iterations)]
    outer_iterations: u32,
    /// Relaxation sweeps in each outer iteration, 1 to 100
    #[arg(long, value_name = "N", help_heading = BLUR, default_value_t = Settings::default().sweeps)]
    sweeps: u32,
    /// Shape of the blur: auto, gaussian, pillbox, half-gaussian, a picture
    ///
    /// auto finds where between a Gaussian and a disk it lies. Its picture may be that of a coded aperture, say.
    #[arg(long, value_name = "K|FILE", help_heading = BLUR, default_value = "auto")]
    kernel: KernelChoice,
    #[command(flatten)]
    tuning: TuningArguments,
}

/// A file with a registration; of a folder of results its report.
pub(crate) fn registration(text: &str) -> Result<PathBuf, Infallible> {
    let path = PathBuf::from(text);
    Ok(if path.is_dir() { path.join(REPORT) } else { path })
}

/// The end of a sweep or a pair that is near, by a number.
pub(crate) fn one_or_two(text: &str) -> Result<u8, String> {
    match text {
        "1" => Ok(1),
        "2" => Ok(2),
        _ => Err("give 1 or 2: which photograph is the one focused nearer, the first (I1) or the second (I2); of a sweep the \
                  first frame or the last"
            .to_string()),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MotionName {
    /// A shift
    Translation,
    /// Besides, rotation and scale: refocusing, and what moves in the plane of the image
    Similarity,
    /// Besides, stretch and shear
    Affine,
    /// Besides, perspective: a camera that turned, a flat scene that was tilted
    Homography,
}

impl From<Motion> for MotionName {
    fn from(motion: Motion) -> Self {
        match motion {
            Motion::Translation => Self::Translation,
            Motion::Similarity => Self::Similarity,
            Motion::Affine => Self::Affine,
            Motion::Homography => Self::Homography,
        }
    }
}

impl From<MotionName> for Motion {
    fn from(name: MotionName) -> Self {
        match name {
            MotionName::Translation => Self::Translation,
            MotionName::Similarity => Self::Similarity,
            MotionName::Affine => Self::Affine,
            MotionName::Homography => Self::Homography,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum StepName {
    GaussNewton,
    GradientDescent,
}

impl From<RegistrationStep> for StepName {
    fn from(step: RegistrationStep) -> Self {
        match step {
            RegistrationStep::GaussNewton => Self::GaussNewton,
            RegistrationStep::GradientDescent => Self::GradientDescent,
        }
    }
}

/// A kernel by name, or a file that holds one.
#[derive(Clone, Debug)]
pub(crate) enum KernelChoice {
    Named(Kernel),
    File(PathBuf),
}

impl FromStr for KernelChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        let named = [Kernel::Auto, Kernel::Gaussian, Kernel::Pillbox, Kernel::HalfGaussian]
            .into_iter()
            .find(|k| k.name() == text);
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

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DecodeName {
    /// As stored
    None,
    /// With the sRGB curve undone, so that blur is linear in them
    Srgb,
    /// By what the files say, which must not contradict each other; where they say nothing, 8 bits are taken for sRGB, more for linear
    Auto,
}

/// How the stored values of photographs become intensities.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Decoding {
    Stated(Decode),
    AsFilesSay,
}

impl Decoding {
    /// For photographs of which this is said.
    pub(crate) fn of(self, files: &[Input]) -> Result<Values, Failure> {
        match self {
            Self::Stated(decode) => Ok(Values::stated(decode)),
            Self::AsFilesSay => Ok(Values::of(files)?),
        }
    }
}

/// A number, or `auto`.
#[derive(Clone, Copy, Debug)]
struct Auto<T>(Option<T>);

impl<T: FromStr> FromStr for Auto<T> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self(None));
        }
        text.parse().map(|number| Self(Some(number))).map_err(|_| "give a number or auto".to_string())
    }
}

impl<T: fmt::Display> fmt::Display for Auto<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            None => f.write_str("auto"),
            Some(number) => number.fmt(f),
        }
    }
}

impl SettingsArguments {
    /// The settings that the flags and `--transform` ask for; with `hold`, what the file states is kept.
    pub(crate) fn settings(&self, method: Method, hold: bool) -> Result<Settings, Failure> {
        let mut settings = Settings {
            method,
            levels: self.levels.0,
            outer_iterations: self.outer_iterations,
            sweeps: self.sweeps,
            regularization: self.regularization.0,
            max_relative_blur: self.max_relative_blur,
            motion: self.motion.into(),
            registration: match self.registration_step {
                StepName::GaussNewton => RegistrationStep::GaussNewton,
                StepName::GradientDescent => RegistrationStep::GradientDescent,
            },
            photometric: !self.no_photometric && self.exposure().is_none(),
            start_photometric: self.exposure().unwrap_or_default(),
            // What files say is known once they are read.
            decode: if let Decoding::Stated(decode) = self.decoding() { decode } else { Decode::None },
            ..Settings::default()
        };
        if method == Method::Sift && self.motion != MotionName::Similarity {
            return Err(Failure::Usage("SIFT finds a similarity; leave out --motion or --method".to_string()));
        }
        self.tuning.apply(&mut settings);
        settings.check()?;
        settings.kernel = self.kernel.read()?;
        self.start_from_file(hold, &mut settings)?;
        Ok(settings)
    }

    /// What photographs without a header hold, if they are that.
    pub(crate) fn raw(&self) -> Option<RawFormat> {
        self.raw
    }

    /// How stored values become intensities.
    pub(crate) fn decoding(&self) -> Decoding {
        match self.decode {
            DecodeName::None => Decoding::Stated(Decode::None),
            DecodeName::Srgb => Decoding::Stated(Decode::Srgb),
            DecodeName::Auto => Decoding::AsFilesSay,
        }
    }

    /// The exposure that is held by flag.
    fn exposure(&self) -> Option<Photometric> {
        let Photometric { gain, offset } = Photometric::IDENTITY;
        let held = Photometric { gain: self.gain.unwrap_or(gain), offset: self.offset.unwrap_or(offset) };
        self.gain.or(self.offset).map(|_| held)
    }

    fn start_from_file(&self, hold: bool, settings: &mut Settings) -> Result<(), Failure> {
        let Some(file) = &self.transform else { return Ok(()) };
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
            return Err(Failure::Failed(format!("{}: {problem}", file.display())));
        };
        settings.start = second.transform;
        if hold {
            settings.method = Method::Aligned;
        }
        if let (Some(start_photometric), None) = (second.photometric, self.exposure()) {
            settings.start_photometric = start_photometric;
            // Only gain and offset can be held: with shading, all are matched again on the T that is held.
            let shaded = second.shading.is_some_and(|shading| shading.is_significant());
            settings.photometric &= !hold || shaded;
        }
        Ok(())
    }

    /// Every file that is read besides photographs, none of which a result may replace.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &PathBuf> {
        let kernel = match &self.kernel {
            KernelChoice::File(path) => Some(path),
            KernelChoice::Named(_) => None,
        };
        self.transform.iter().chain(kernel).chain(self.config.file())
    }
}
