//! The settings of a solve: one table of names, types, defaults, ranges and descriptions.

use std::fmt::Display;

use crate::base::color::Decode;
use crate::base::{Depth, Error, Homography, Kernel};

choices! {
    /// The system that is solved: registration and relative blur together, or one before the other.
    pub enum Method {
        /// Registration together with the blur: sections 2 to 4 of the paper
        #[default]
        Unified = "unified",
        /// No registration: T is held at its start
        Aligned = "aligned",
        /// Registration before the blur, by the difference of the images (equation 36 of the paper)
        Appearance = "appearance",
        /// Registration before the blur, by SIFT key-points, which need no start
        Sift = "sift",
    }
}

choices! {
    /// The motion model of T: each is a special case of the next.
    #[derive(PartialOrd, Ord)]
    pub enum Motion {
        /// Shift along x and y
        Translation = "translation",
        /// Also rotation and scale: refocusing, and movement in the plane of the image
        #[default]
        Similarity = "similarity",
        /// Also stretch and shear
        Affine = "affine",
        /// Also perspective: a camera that turned, or a flat scene that was tilted
        Homography = "homography",
    }
}

impl Motion {
    /// The number of parameters.
    pub fn unknowns(self) -> usize {
        match self {
            Motion::Translation => 2,
            Motion::Similarity => 4,
            Motion::Affine => 6,
            Motion::Homography => 8,
        }
    }
}

choices! {
    /// How T is updated in each outer iteration.
    pub enum RegistrationStep {
        /// Gauss-Newton on the energy, with each pixel's change of V eliminated
        #[default]
        GaussNewton = "gauss-newton",
        /// Gradient descent at fixed V: the paper's explicit scheme, to compare with
        GradientDescent = "gradient-descent",
    }
}

choices! {
    /// Whether parallax is found, of a camera that moved.
    pub enum ParallaxSearch {
        /// Where the photographs show it beyond doubt
        #[default]
        Auto = "auto",
        /// Of a pair wherever it explains something
        On = "on",
        /// Never
        Off = "off",
    }
}

/// Parallax of a camera that moved between the photographs: a pixel x with relative blur V is displaced by
/// `(across + along (x - c)) V` before T maps it, c being the image centre. Linear in V, since both are linear in one
/// over the distance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Parallax {
    /// By movement across the optical axis, pixels of I1 per px² of V, to the right and downwards.
    pub across: [f64; 2],
    /// By movement along the axis, per px² of V.
    pub along: f64,
}

impl Parallax {
    /// A camera that did not move.
    pub const NONE: Self = Self { across: [0.0; 2], along: 0.0 };

    /// The same with places from the centre `to` instead of `from`, px.
    pub(crate) fn about(self, from: [f64; 2], to: [f64; 2]) -> Self {
        Self { across: [0, 1].map(|c| self.across[c] + self.along * (to[c] - from[c])), ..self }
    }

    /// The displacement of a place from the centre with this V, px.
    pub(crate) fn displacement(self, [x, y]: [f64; 2], v: f64) -> [f64; 2] {
        [v * (self.across[0] + self.along * x), v * (self.across[1] + self.along * y)]
    }

    /// The numbers: across, to the right and downwards, then along.
    pub fn numbers(self) -> [f64; 3] {
        [self.across[0], self.across[1], self.along]
    }

    /// These standard deviations, with a share of another parallax as one more.
    pub(crate) fn with(self, other: Self, share: f64) -> Self {
        let across = [0, 1].map(|c| self.across[c].hypot(share * other.across[c]));
        Self { across, along: self.along.hypot(share * other.along) }
    }

    /// That of photographs of twice the size, in whose pixels V is four times as large.
    pub(crate) fn doubled(self) -> Self {
        Self { across: self.across.map(|across| across / 2.0), along: self.along / 4.0 }
    }
}

/// Gain and offset that map I2 onto I1: `J = gain I2(T x) + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Photometric {
    /// Factor on I2.
    pub gain: f64,
    /// Added after the gain, in intensities of [0, 1].
    pub offset: f64,
}

impl Photometric {
    /// Equal exposures.
    pub const IDENTITY: Self = Self { gain: 1.0, offset: 0.0 };
}

impl Default for Photometric {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// A row of the table of settings.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// The field of [`Settings`], the key of a configuration file (with `-`), the keyword of Python, the field of C.
    pub name: &'static str,
    /// The unit, or "".
    pub unit: &'static str,
    /// The least and the largest value as text.
    pub range: Option<[&'static str; 2]>,
    /// The default as text.
    pub default: fn() -> String,
    /// What it is: the first line stands alone, the others add details.
    pub doc: &'static str,
    /// The section of the program's help and the placeholder of the value; `None`: the program has no flag of this
    /// name.
    pub flag: Option<[&'static str; 2]>,
    /// The parser of the flag's value.
    #[cfg(feature = "program")]
    pub parser: fn() -> clap::builder::ValueParser,
}

/// A type of settings: what the table needs to check, print and parse a value.
trait Value: Sized {
    /// The value that has a range.
    fn number(&self) -> Option<f64> {
        None
    }

    fn text(&self) -> String;

    fn parse(text: &str) -> Option<Self>;

    #[cfg(feature = "program")]
    fn parser() -> clap::builder::ValueParser {
        clap::builder::ValueParser::string()
    }
}

macro_rules! plain_values {
    ($($type:ty: $number:expr;)*) => { $(
        impl Value for $type {
            fn number(&self) -> Option<f64> {
                let number: fn($type) -> Option<f64> = $number;
                number(*self)
            }

            fn text(&self) -> String {
                self.to_string()
            }

            fn parse(text: &str) -> Option<Self> {
                text.parse().ok()
            }

            #[cfg(feature = "program")]
            fn parser() -> clap::builder::ValueParser {
                clap::value_parser!($type).into()
            }
        }
    )* };
}

plain_values! {
    u32: |value| Some(value.into());
    f64: Some;
}

impl Value for bool {
    fn text(&self) -> String {
        self.to_string()
    }

    fn parse(text: &str) -> Option<Self> {
        match text {
            "true" | "on" => Some(true),
            "false" | "off" => Some(false),
            _ => None,
        }
    }

    #[cfg(feature = "program")]
    fn parser() -> clap::builder::ValueParser {
        ["on", "off", "true", "false"].into()
    }
}

macro_rules! named_values {
    ($($type:ty),*) => { $(
        impl Value for $type {
            fn text(&self) -> String {
                self.name().to_string()
            }

            fn parse(text: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|value| value.name() == text)
            }

            #[cfg(feature = "program")]
            fn parser() -> clap::builder::ValueParser {
                clap::builder::EnumValueParser::<$type>::new().into()
            }
        }
    )* };
}

named_values!(Method, Motion, RegistrationStep, ParallaxSearch, Decode);

/// `None` is "auto".
impl<T: Value + Display> Value for Option<T> {
    fn number(&self) -> Option<f64> {
        self.as_ref().and_then(Value::number)
    }

    fn text(&self) -> String {
        self.as_ref().map_or_else(|| "auto".to_string(), ToString::to_string)
    }

    fn parse(text: &str) -> Option<Self> {
        if text == "auto" { Some(None) } else { T::parse(text).map(Some) }
    }

    #[cfg(feature = "program")]
    fn parser() -> clap::builder::ValueParser {
        let check = |text: &str| match Self::parse(text) {
            Some(_) => Ok(text.to_string()),
            None => Err("give a number or auto"),
        };
        clap::builder::ValueParser::new(check)
    }
}

impl Value for Kernel {
    fn text(&self) -> String {
        self.name().to_string()
    }

    fn parse(text: &str) -> Option<Self> {
        Self::NAMED.into_iter().find(|kernel| kernel.name() == text)
    }
}

impl Value for Homography {
    fn text(&self) -> String {
        "identity".to_string()
    }

    fn parse(_: &str) -> Option<Self> {
        None
    }
}

impl Value for Photometric {
    fn text(&self) -> String {
        format!("gain {}, offset {}", self.gain, self.offset)
    }

    fn parse(_: &str) -> Option<Self> {
        None
    }
}

macro_rules! optional {
    () => {
        None
    };
    ($value:expr) => {
        Some($value)
    };
}

/// Makes [`Settings`], its defaults, range checks and table of one list of fields.
macro_rules! settings {
    ($($(#[doc = $doc:literal])+ $name:ident: $type:ty = $default:expr
        $(, $low:literal to $high:literal $($unit:literal)?)? $(, flag $heading:literal $placeholder:literal)?;)*) => {
        /// The settings of a solve.
        ///
        /// Intensities are in [0, 1], blur in px². `docs/method.md`, section 8, has the same table.
        #[derive(Clone, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct Settings { $(
            $(#[doc = $doc])+
            ///
            #[doc = concat!("Default `", stringify!($default), "`" $(, ", range ", $low, " to ", $high $(, " ", $unit)?)?, ".")]
            pub $name: $type,
        )* }

        impl Default for Settings {
            fn default() -> Self {
                Self { $($name: $default,)* }
            }
        }

        impl Settings {
            /// The table of the settings, a row a field.
            #[doc(hidden)]
            pub const TABLE: &[Setting] = &[$(Setting {
                name: stringify!($name),
                unit: concat!("" $($(, $unit)?)?),
                range: optional!($([stringify!($low), stringify!($high)])?),
                default: || <$type as Value>::text(&$default),
                doc: concat!($($doc, "\n"),+).trim_ascii(),
                flag: optional!($([$heading, $placeholder])?),
                #[cfg(feature = "program")]
                parser: <$type as Value>::parser,
            }),*];

            /// Sets a field by its name; false if there is no such field or the text is no value of it.
            #[doc(hidden)]
            pub fn set(&mut self, name: &str, text: &str) -> bool {
                match name {
                    $(stringify!($name) => <$type as Value>::parse(text).map(|value| self.$name = value).is_some(),)*
                    _ => false,
                }
            }

            /// A field as text.
            #[doc(hidden)]
            pub fn get(&self, name: &str) -> Option<String> {
                match name {
                    $(stringify!($name) => Some(self.$name.text()),)*
                    _ => None,
                }
            }

            /// Checks the range of each field that has one.
            fn check_fields(&self) -> Result<(), Error> {
                $($(if let Some(value) = self.$name.number() {
                    in_range(stringify!($name), value, range::$name, [stringify!($low), stringify!($high)])?;
                })?)*
                Ok(())
            }
        }

        /// The range of each field that has one.
        #[allow(non_upper_case_globals, reason = "named like the fields")]
        mod range {
            $($(pub(super) const $name: [f64; 2] = [$low as f64, $high as f64];)?)*
        }
    };
}

settings! {
    /// How registration and relative blur are combined.
    method: Method = Method::Unified;
    /// How stored values become intensities.
    decode: Decode = Decode::Auto, flag "Input" "HOW";
    /// Motion model of T.
    /// The summary says when a simpler model explains as much or a richer one more. SIFT finds a similarity at most.
    motion: Motion = Motion::Similarity, flag "Registration" "MODEL";
    /// Whether parallax is found, of a camera that moved between the photographs.
    /// Near things are then displaced against far ones, in proportion to V. Of a pair auto takes it only if three quarters of
    /// the photographs show it by themselves, and no map of the plane explains the same. on takes it if it explains anything.
    parallax: ParallaxSearch = ParallaxSearch::Auto, flag "Registration" "WHERE";
    /// How T is updated in each outer iteration.
    registration_step: RegistrationStep = RegistrationStep::GaussNewton, flag "Registration" "STEP";
    /// Whether gain, offset and shading of the two images are matched.
    photometric: bool = true;
    /// Where T starts; with the method aligned it stays there.
    start: Homography = Homography::IDENTITY;
    /// Where gain and offset start; without `photometric` they stay there.
    start_photometric: Photometric = Photometric::IDENTITY;
    /// Pyramid levels.
    /// auto halves the images while the short side stays at least 32 px.
    levels: Option<u32> = None, 1 to 12, flag "Relative blur V" "N|auto";
    /// Largest |V|.
    /// V is the difference of the blurs' variances, px² of the full-size image. auto is 144 px², and 1024 for a pair that
    /// reaches it at more than a tenth of its pixels: it is solved again. A wide limit takes memory, and on GPUs time.
    max_relative_blur: Option<f64> = None, 1 to 1024 "px²", flag "Relative blur V" "PX2";
    /// Smoothness α of V; less shows more relief and noise.
    /// auto finds α on each level, from the evidence against V and its slope (docs/method.md, section 6). The report
    /// states what it found.
    regularization: Option<f64> = None, 1e-6 to 10, flag "Relative blur V" "A|auto";
    /// Outer iterations on each level, at most.
    /// A level stops once it has settled, usually after 4 to 18.
    outer_iterations: u32 = 100, 5 to 1000, flag "Relative blur V" "N";
    /// Red-black relaxation sweeps in each outer iteration, on each grid but the coarsest.
    relaxation_sweeps: u32 = 3, 1 to 100, flag "Relative blur V" "N";
    /// Shape of the blur.
    /// auto finds whether it is a Gaussian or a disk, and how far the focus settings are apart.
    kernel: Kernel = Kernel::Auto;
    /// Whether depth edges are as sharp as the scene's.
    /// Where two layers explain the photographs better, V passes from one depth to the other at their outline, instead
    /// of over some 5 px around it.
    edges: bool = true, flag "Relative blur V" "on|off";
    /// Whether the fused image of a pair is computed; depth and registration do not need it.
    /// Its pass takes a twentieth of the solve of 1 Mpx in grey (`parfocal bench`, lavapipe). Without it a quarter less
    /// is read back, of colour half.
    fused: bool = true;
    /// Whether frames of a sweep are kept that do not show the scene of the others.
    /// Otherwise they are left out, and a warning names each with its reason.
    keep_frames: bool = false;
    /// Over-relaxation ω.
    over_relaxation: f64 = 1.3, 0.01 to 1.99, flag "Fine tuning" "W";
    /// On the coarsest level α starts 1 + C times too large.
    continuation: f64 = 10.0, 0 to 1000, flag "Fine tuning" "C";
    /// η of the data term's modified L1 norm.
    /// In units of intensity (docs/method.md, section 1), so that it suits dark photographs too.
    data_eta: f64 = 0.01, 1e-4 to 1 "units of intensity", flag "Fine tuning" "E";
    /// η of the smoothness term's modified L1 norm.
    smoothness_eta: f64 = 0.1, 1e-4 to 100 "px² per pixel", flag "Fine tuning" "E";
    /// Largest change of V in one outer iteration, in px² of the level.
    largest_step: f64 = 1.0, 0.01 to 100 "px²", flag "Fine tuning" "PX2";
    /// Stored value from which a sample is clipped at white.
    /// auto is the greatest value of integers, 255 or 65535, and none for floats. A pixel has no weight if one of its
    /// channels is clipped.
    white_level: Option<f64> = None, -1e6 to 1e6, flag "Fine tuning" "V|auto";
    /// Stored value up to which a sample is clipped at black.
    /// auto is 0 for integers and none for floats. A pixel has no weight if all its channels are clipped.
    black_level: Option<f64> = None, -1e6 to 1e6, flag "Fine tuning" "V|auto";
}

fn in_range(name: &'static str, value: f64, [low, high]: [f64; 2], text: [&str; 2]) -> Result<(), Error> {
    if value >= low && value <= high {
        return Ok(());
    }
    Err(Error::Setting { name, value, range: format!("{} to {}", text[0], text[1]) })
}

impl Settings {
    /// The limit of |V| that `auto` starts from, px². GPUs pack the blur stacks up to it.
    pub(crate) const USUAL_BLUR: f64 = 144.0;
    /// The widest limit of |V|, px².
    pub(crate) const WIDEST_BLUR: f64 = range::max_relative_blur[1];

    /// The limit of |V| of a solve by these settings, px².
    pub(crate) fn blur_limit(&self) -> f64 {
        self.max_relative_blur.unwrap_or(Self::USUAL_BLUR)
    }

    /// Black and white level of samples of this kind, integers on a scale from 0 to 1.
    pub(crate) fn clipped(&self, depth: Depth) -> [f32; 2] {
        let greatest = match depth {
            Depth::U8 => 255.0,
            Depth::U16 => 65535.0,
            Depth::F32 => {
                let level = |stated: Option<f64>, none: f32| stated.map_or(none, |level| level as f32);
                return [level(self.black_level, f32::NEG_INFINITY), level(self.white_level, f32::INFINITY)];
            }
        };
        // Half a step from the next value, since a device may round a quotient either way.
        let black = (self.black_level.unwrap_or(0.0) + 0.5) / greatest;
        let white = (self.white_level.unwrap_or(greatest) - 0.5) / greatest;
        [black as f32, white as f32]
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Setting`] with the name, the value and the range of the first setting that is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.check_fields()?;
        let sweeps = f64::from(self.outer_iterations) * f64::from(self.relaxation_sweeps);
        in_range("the product of outer_iterations and relaxation_sweeps", sweeps, [1.0, 1e4], ["1", "10000"])?;
        let ([tx, ty], [gx, gy]) = (self.start.translation(), self.start.perspective());
        // The horizon 10 px from the centre: what is meant are pixels, not shares of the image.
        let (far, tilted) = (([-1e5, 1e5], ["-1e5", "1e5"]), ([-0.1, 0.1], ["-0.1", "0.1"]));
        let Photometric { gain, offset } = self.start_photometric;
        for (name, value, (range, text)) in [
            ("the x translation of start", tx, far),
            ("the y translation of start", ty, far),
            ("the scale of start", self.start.scale(), ([0.1, 10.0], ["0.1", "10"])),
            ("the x perspective of start", gx, tilted),
            ("the y perspective of start", gy, tilted),
            ("the gain of start_photometric", gain, ([1e-3, 1e3], ["1e-3", "1e3"])),
            ("the offset of start_photometric", offset, ([-1e3, 1e3], ["-1e3", "1e3"])),
        ] {
            in_range(name, value, range, text)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_default_that_is_set_from_its_text_stays_the_default() {
        for setting in Settings::TABLE {
            let (mut settings, default) = (Settings::default(), (setting.default)());
            assert_eq!(settings.get(setting.name).as_ref(), Some(&default));
            let is_text = !["start", "start_photometric"].contains(&setting.name);
            assert_eq!(settings.set(setting.name, &default), is_text, "{}", setting.name);
            assert_eq!(settings, Settings::default());
        }
        let mut settings = Settings::default();
        assert!(
            settings.set("relaxation_sweeps", "7") && settings.set("levels", "3") && settings.set("motion", "affine")
        );
        assert_eq!((settings.relaxation_sweeps, settings.levels, settings.motion), (7, Some(3), Motion::Affine));
        assert!(!settings.set("levels", "many") && !settings.set("sweeps", "7"));
    }

    #[test]
    fn a_value_beyond_its_range_is_refused_with_name_and_range() {
        for setting in Settings::TABLE {
            let Some([low, high]) = setting.range else { continue };
            for (text, is_good) in [(low, true), ("-2e6", false), ("99999999", false), ("nan", false)] {
                let mut settings = Settings { outer_iterations: 5, relaxation_sweeps: 1, ..Settings::default() };
                if !settings.set(setting.name, text) {
                    continue;
                }
                let problem = settings.check().err().map(|error| error.to_string());
                assert_eq!(problem.is_none(), is_good, "{problem:?}");
                let ends = format!("and must be {low} to {high}");
                assert!(problem.is_none_or(|p| p.starts_with(setting.name) && p.ends_with(&ends)), "{}", setting.name);
            }
        }
        let many = Settings { outer_iterations: 1000, relaxation_sweeps: 11, ..Settings::default() };
        assert!(many.check().is_err());
    }

    #[test]
    fn the_table_in_docs_method_md_states_name_default_and_range() {
        let text = include_str!("../../docs/method.md");
        for setting in Settings::TABLE {
            let range = setting.range.map_or_else(String::new, |[low, high]| format!("{low} to {high}"));
            let row = format!("| `{}` | {} | {range} |", setting.name, (setting.default)()).replace("  ", " ");
            assert!(text.contains(&row), "docs/method.md, section 8, lacks the row {row}");
        }
    }
}
