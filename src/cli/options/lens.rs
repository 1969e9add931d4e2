//! The options of the lens, from a file and from flags.

use std::path::{Path, PathBuf};

use parfocal::export::{Nearer, Results};
use parfocal::image_io::{Exif, Input};
use parfocal::metric::LensField;
use parfocal::{Lens, internals::bounded_read};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cli::help::LENS;
use crate::cli::options::part::numbers;
use crate::cli::output::failure::Failure;

/// Greatest size of a lens file, 16 MiB, like that of a report.
const MAX_BYTES: u64 = 16 << 20;

/// The lens; flags override the file.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct LensArguments {
    /// The lens, for depth in mm: JSON as calibrate writes it
    ///
    /// An object with focal_length_mm, f_number, pixel_pitch_mm, focus_mm, kappa, telecentric and field. Or a file with
    /// such an object under the key lens: the output of calibrate, truth.json of simulate, report.json. Flags override
    /// the file.
    #[arg(long, value_name = "FILE", help_heading = LENS)]
    lens: Option<PathBuf>,
    #[command(flatten)]
    flags: PartOfLens,
}

/// The known fields of a lens, as options and in a file.
#[derive(clap::Args, Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PartOfLens {
    /// Focal length, mm
    #[serde(rename = "focal_length_mm")]
    #[arg(long, value_name = "MM", help_heading = LENS)]
    pub(crate) focal_length: Option<f64>,
    /// f-number
    #[arg(long, value_name = "N", help_heading = LENS)]
    pub(crate) f_number: Option<f64>,
    /// Distance between pixels on the sensor, mm
    #[serde(rename = "pixel_pitch_mm")]
    #[arg(long, value_name = "MM", help_heading = LENS)]
    pub(crate) pixel_pitch: Option<f64>,
    /// Distances from the lens at which I1 and I2 are focused, mm
    #[serde(rename = "focus_mm")]
    #[arg(long, value_name = "MM,MM", help_heading = LENS, allow_hyphen_values = true, value_parser = distances)]
    pub(crate) focus: Option<[f64; 2]>,
    /// Standard deviation of the blur over its radius; calibrate finds it [default: 0.5, a disk]
    #[arg(long, value_name = "K", help_heading = LENS)]
    pub(crate) kappa: Option<f64>,
    /// Lens that is telecentric on the image side: focus does not change its magnification
    #[arg(long, value_name = "BOOL", help_heading = LENS, num_args = 0..=1, require_equals = true,
          default_missing_value = "true")]
    pub(crate) telecentric: Option<bool>,
    /// How V changes over the field. Only a file states it
    #[serde(skip_serializing_if = "Option::is_none")]
    #[arg(skip)]
    pub(crate) field: Option<LensField>,
}

fn distances(text: &str) -> Result<[f64; 2], String> {
    numbers(text).ok_or_else(|| "give two distances in mm, as in 529,869".to_string())
}

impl From<Lens> for PartOfLens {
    fn from(lens: Lens) -> Self {
        Self {
            focal_length: Some(lens.focal_length),
            f_number: Some(lens.f_number),
            pixel_pitch: Some(lens.pixel_pitch),
            focus: Some(lens.focus),
            kappa: Some(lens.kappa),
            telecentric: Some(lens.telecentric),
            field: lens.field,
        }
    }
}

impl PartOfLens {
    /// The fields that the photographs state; none if they contradict each other.
    pub(crate) fn of_photographs(inputs: &[Input]) -> Self {
        let agreed = |of: fn(&Exif) -> Option<f64>| {
            let mut stated = inputs.iter().filter_map(|input| of(input.exif.as_ref()?));
            let first = stated.next()?;
            stated.all(|other| other == first).then_some(first)
        };
        let focus = |input: &Input| input.exif.as_ref()?.subject_distance_mm;
        Self {
            focal_length: agreed(|exif| exif.focal_length_mm),
            f_number: agreed(|exif| exif.f_number),
            pixel_pitch: agreed(|exif| exif.pixel_pitch_mm),
            focus: inputs.first().and_then(focus).zip(inputs.get(1).and_then(focus)).map(|(a, b)| [a, b]),
            ..Self::default()
        }
    }

    /// Fills in missing fields from `other`. A lens that states focus distances keeps its own `field`, or has none.
    pub(crate) fn or(self, other: Self) -> Self {
        Self {
            focal_length: self.focal_length.or(other.focal_length),
            f_number: self.f_number.or(other.f_number),
            pixel_pitch: self.pixel_pitch.or(other.pixel_pitch),
            focus: self.focus.or(other.focus),
            kappa: self.kappa.or(other.kappa),
            telecentric: self.telecentric.or(other.telecentric),
            field: if self.focus.is_some() { self.field } else { self.field.or(other.field) },
        }
    }

    /// Refuses optics that differ from those of a lens with a field, which holds for that lens only. `whose` names the
    /// lens.
    fn check_field_of(&self, lens: &Self, whose: &str) -> Result<(), Failure> {
        fn differs<T: PartialEq>(stated: Option<T>, of_lens: Option<T>) -> bool {
            stated.zip(of_lens).is_some_and(|(stated, of_lens)| stated != of_lens)
        }
        let differing: Vec<&str> = [
            (differs(self.focal_length, lens.focal_length), "--focal-length"),
            (differs(self.f_number, lens.f_number), "--f-number"),
            (differs(self.pixel_pitch, lens.pixel_pitch), "--pixel-pitch"),
            (differs(self.focus, lens.focus), "--focus"),
            (differs(self.telecentric, lens.telecentric), "--telecentric"),
        ]
        .iter()
        .filter_map(|&(is_different, flag)| is_different.then_some(flag))
        .collect();
        if lens.field.is_none() || differing.is_empty() {
            return Ok(());
        }
        Err(Failure::Usage(format!(
            "{whose} has a field, which was calibrated with another {}; give a whole lens without a field, or \
             calibrate again",
            differing.join(", ")
        )))
    }

    /// The lens, if no field is missing.
    pub(crate) fn if_whole(self) -> Result<Option<Lens>, Failure> {
        let Self { focal_length, f_number, pixel_pitch, focus, .. } = self;
        let is_whole = focal_length.is_some() && f_number.is_some() && pixel_pitch.is_some() && focus.is_some();
        is_whole.then(|| self.whole()).transpose()
    }

    /// The whole lens, or an error that names the missing options.
    pub(crate) fn whole(self) -> Result<Lens, Failure> {
        let (Some(focal_length), Some(f_number), Some(pixel_pitch), Some(focus)) =
            (self.focal_length, self.f_number, self.pixel_pitch, self.focus)
        else {
            let missing: Vec<&str> = [
                (self.focal_length.is_none(), "--focal-length"),
                (self.f_number.is_none(), "--f-number"),
                (self.pixel_pitch.is_none(), "--pixel-pitch"),
                (self.focus.is_none(), "--focus"),
            ]
            .iter()
            .filter_map(|&(is_missing, flag)| is_missing.then_some(flag))
            .collect();
            let problem = format!("the lens is not whole: give {}, or --lens FILE with it", missing.join(", "));
            return Err(Failure::Usage(problem));
        };
        let (kappa, telecentric) = (self.kappa.unwrap_or(Lens::DISK), self.telecentric.unwrap_or(false));
        let lens = Lens { focal_length, f_number, pixel_pitch, focus, kappa, telecentric, field: self.field };
        lens.check()?;
        Ok(lens)
    }
}

impl LensArguments {
    /// The whole and checked lens; `None` if neither file nor options state a field. Missing fields are taken from
    /// `defaults`.
    pub(crate) fn lens(&self, defaults: PartOfLens) -> Result<Option<Lens>, Failure> {
        self.stated()?.map(|stated| stated.or(defaults).whole()).transpose()
    }

    /// The fields of the file and the options; `None` if there are none.
    pub(crate) fn stated(&self) -> Result<Option<PartOfLens>, Failure> {
        let file = self.lens.as_deref().map_or(Ok(PartOfLens::default()), read)?;
        if let Some(path) = &self.lens {
            self.flags.check_field_of(&file, &path.display().to_string())?;
        }
        Ok(self.is_given().then(|| PartOfLens { field: file.field, ..self.flags.or(file) }))
    }

    /// The lens for a command that needs one. Missing fields are taken from the report of the results.
    pub(crate) fn required(&self, results: &Results<'_>) -> Result<Lens, Failure> {
        let known = results.lens().copied().map(PartOfLens::from);
        match self.stated()?.or(known) {
            Some(stated) => {
                let known = known.unwrap_or_default();
                if stated.focus.is_none() {
                    stated.check_field_of(&known, "the lens of the results")?;
                }
                stated.or(known).whole()
            }
            None => {
                let problem = "give the lens: --lens FILE, or --focal-length and the other options of the lens";
                Err(Failure::Usage(problem.to_string()))
            }
        }
    }

    /// Whether a file or an option of the lens was given.
    pub(crate) fn is_given(&self) -> bool {
        self.lens.is_some() || self.flags != PartOfLens::default()
    }

    /// The lens file. No result may replace it.
    pub(crate) fn file(&self) -> Option<&PathBuf> {
        self.lens.as_ref()
    }
}

/// The image that is focused nearer, from `--nearer` and from the lens, which must agree.
pub(crate) fn nearer(stated: Option<u8>, lens: Option<&Lens>) -> Result<Nearer, Failure> {
    let stated = stated.map(|number| if number == 2 { Nearer::Second } else { Nearer::First });
    let Some(lens) = lens else { return Ok(stated.unwrap_or_default()) };
    let nearer = Nearer::of_lens(lens);
    if let Some(other) = stated.filter(|&stated| stated != nearer) {
        let [first, second] = lens.focus;
        return Err(Failure::Usage(format!(
            "--nearer {} contradicts the lens, by which I{} is focused nearer ({first} and {second} mm); leave --nearer out",
            other.number(),
            nearer.number()
        )));
    }
    Ok(nearer)
}

/// Reads a lens, or a file that contains one as `lens` or `depth.lens`.
fn read(path: &Path) -> Result<PartOfLens, Failure> {
    let failed = |problem: String| Failure::file(path, problem);
    let text = bounded_read::text(path, MAX_BYTES)
        .map_err(|e| failed(format!("cannot be read as a lens ({e}); check the path")))?;
    let value: Value = serde_json::from_str(&text).map_err(|e| failed(format!("is not JSON ({e})")))?;
    let lens = value.get("lens").or_else(|| value.get("depth")?.get("lens")).unwrap_or(&value);
    PartOfLens::deserialize(lens).map_err(|e| failed(format!("holds no lens that can be used ({e})")))
}

/// Reads a file, for fuzz tests.
#[cfg(test)]
pub(crate) fn reads(file: &Path) {
    let _ = read(file);
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::cli::options::run::parsed;

    const CUP: &str = r#"{"focal_length_mm": 25, "f_number": 8.3, "pixel_pitch_mm": 0.01304, "focus_mm": [529, 869],
        "telecentric": true}"#;

    fn lens(json: Option<&str>, flags: &[&str]) -> Result<Option<Lens>, Failure> {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut arguments = Vec::new();
        if let Some(json) = json {
            fs::write(file.path(), json).unwrap();
            arguments.extend(["--lens", file.path().to_str().unwrap()]);
        }
        arguments.extend(flags);
        parsed::<LensArguments>(&arguments).lens(PartOfLens::default())
    }

    #[test]
    fn file_and_flags_make_the_same_lens() {
        let flags = ["--focal-length=25", "--f-number=8.3", "--pixel-pitch=0.01304", "--focus=529,869"];
        let cup = lens(Some(CUP), &[]).unwrap().unwrap();
        assert_eq!((cup.kappa, cup.telecentric, cup.focus), (Lens::DISK, true, [529.0, 869.0]));
        assert_eq!(lens(None, &[&flags[..], &["--telecentric"]].concat()).unwrap(), Some(cup));
        let other = lens(Some(CUP), &["--kappa=0.4", "--telecentric=false"]).unwrap().unwrap();
        assert_eq!(other, Lens { kappa: 0.4, telecentric: false, ..cup });
        for wrapped in [format!(r#"{{"lens": {CUP}, "more": 1}}"#), format!(r#"{{"depth": {{"lens": {CUP}}}}}"#)] {
            assert_eq!(lens(Some(&wrapped), &[]).unwrap(), Some(cup));
        }
        assert_eq!(lens(None, &[]).unwrap(), None);
        let part: LensArguments = parsed(&["--f-number=4"]);
        assert_eq!(part.lens(cup.into()).unwrap(), Some(Lens { f_number: 4.0, ..cup }));
    }

    #[test]
    fn a_field_stays_with_its_optics() {
        let zeros = |n: usize| vec!["0"; n].join(",");
        let field =
            format!(r#", "field": {{"size": [96, 64], "gain": [{}], "offset_px2": [{}]}}}}"#, zeros(5), zeros(14));
        let bowed = CUP.replace('}', &field);
        let cup = lens(Some(&bowed), &["--focus=529,869", "--kappa=0.4"]).unwrap().unwrap();
        assert!(cup.field.is_some() && cup.kappa == 0.4);
        for flag in
            ["--focus=869,529", "--f-number=2", "--focal-length=30", "--pixel-pitch=0.01", "--telecentric=false"]
        {
            let name = flag.split('=').next().unwrap();
            assert!(matches!(lens(Some(&bowed), &[flag]), Err(Failure::Usage(m)) if m.contains(name)), "{flag}");
        }
        let other = PartOfLens { field: None, ..cup.into() };
        assert_eq!(other.or(cup.into()).field, None, "a whole lens has its own field");
        assert_eq!(PartOfLens { focus: None, ..other }.or(cup.into()).field, cup.field);
    }

    #[test]
    fn missing_unknown_and_impossible_fields_are_named() {
        let message = |json, flags: &[&str]| lens(json, flags).unwrap_err().message();
        assert!(message(None, &["--f-number=8"]).contains("--focal-length, --pixel-pitch, --focus"));
        let unknown = message(Some(r#"{"fnumber": 8}"#), &[]);
        assert!(unknown.contains("`fnumber`") && unknown.contains("`f_number`"), "{unknown}");
        assert!(message(Some(CUP), &["--focus=20,869"]).contains("more than the focal length"));
        assert!(message(Some("7"), &[]).contains("no lens"));
    }

    #[test]
    fn nearer_must_not_contradict_the_lens() {
        let cup = lens(Some(CUP), &[]).unwrap().unwrap();
        let turned = Lens { focus: [869.0, 529.0], ..cup };
        assert_eq!(nearer(None, Some(&turned)).unwrap(), Nearer::Second);
        assert_eq!(nearer(Some(1), Some(&cup)).unwrap(), Nearer::First);
        assert_eq!(nearer(Some(2), None).unwrap(), Nearer::Second);
        assert!(matches!(nearer(Some(2), Some(&cup)), Err(Failure::Usage(m)) if m.contains("--nearer 2")));
    }
}
