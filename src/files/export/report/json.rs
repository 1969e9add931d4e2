//! JSON files of parfocal: their first keys, how they are written, and how they are read.

use std::io::{self, Write};
use std::path::{Component, Path};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};

use crate::base::Error;
use crate::files::bounded_read;

/// The value of `program` in every JSON file of parfocal.
pub(in crate::files::export) const PROGRAM: &str = "parfocal";

/// Greatest number of bytes of a report that are read, 16 MiB. A report with every level and iteration at its limit has
/// less than 1 MiB.
pub(in crate::files::export) const MAX_BYTES: u64 = 16 << 20;

/// The subject of a JSON file of parfocal; its key is `kind`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The solve of a pair.
    #[default]
    Pair,
    /// The solve of a focus sweep.
    Sweep,
    /// The registration of a pair or a focus sweep.
    Registration,
    /// A synthetic pair or focus sweep, with its truth.
    Simulation,
    /// A batch of pairs and focus sweeps.
    Batch,
    /// The inspection of a part.
    Inspection,
    /// A golden part.
    Golden,
    /// Repeated measurements.
    Repeatability,
    /// A calibrated lens.
    Lens,
    /// A benchmark.
    Bench,
    /// An evaluation of the program.
    Evaluation,
}

impl Kind {
    /// The kind that a JSON file states; `None` for a file of another program.
    pub(crate) fn of(file: &Value) -> Option<Self> {
        (file.get("program")? == PROGRAM).then(|| Self::deserialize(file.get("kind")?).ok()).flatten()
    }
}

/// The first keys of a JSON file of parfocal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Header {
    program: &'static str,
    kind: Kind,
}

impl Header {
    /// Header of a file of this kind.
    pub fn new(kind: Kind) -> Self {
        Self { program: PROGRAM, kind }
    }
}

/// The text of a JSON value with the program, the kind and this value.
pub(crate) fn with_header(kind: Kind, value: &impl Serialize) -> impl Serialize {
    #[derive(Serialize)]
    struct Whole<'a, T: Serialize> {
        #[serde(flatten)]
        header: Header,
        #[serde(flatten)]
        value: &'a T,
    }
    Whole { header: Header::new(kind), value }
}

/// Writes a value as JSON and a newline.
pub(crate) fn write_json_to(mut writer: impl Write, value: &impl Serialize) -> Result<(), String> {
    let text = to_json(value).map_err(|e| e.to_string())?;
    writeln!(writer, "{text}").map_err(|e| e.to_string())
}

/// The text of a report as JSON, as in its file: indented, without negative zeros, and without a newline at its end.
///
/// # Errors
/// None is known for the reports; serde_json's signature allows one.
pub fn to_json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut bytes = Vec::new();
    value.serialize(&mut Serializer::with_formatter(&mut bytes, PositiveZeros(PrettyFormatter::new())))?;
    String::from_utf8(bytes).map_err(serde::ser::Error::custom)
}

/// [`PrettyFormatter`] that writes -0 as 0.
struct PositiveZeros(PrettyFormatter<'static>);

/// Delegates methods of [`Formatter`].
macro_rules! pass_on {
    ($($name:ident($($argument:ident: $type:ty),*);)*) => {
        $(fn $name<W: ?Sized + Write>(&mut self, writer: &mut W $(, $argument: $type)*) -> io::Result<()> {
            self.0.$name(writer $(, $argument)*)
        })*
    };
}

impl Formatter for PositiveZeros {
    fn write_f32<W: ?Sized + Write>(&mut self, writer: &mut W, value: f32) -> io::Result<()> {
        // Adding zero makes -0 positive and does not change any other number.
        self.0.write_f32(writer, value + 0.0)
    }

    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        self.0.write_f64(writer, value + 0.0)
    }

    pass_on! {
        begin_array();
        end_array();
        begin_array_value(first: bool);
        end_array_value();
        begin_object();
        end_object();
        begin_object_key(first: bool);
        begin_object_value();
        end_object_value();
    }
}

/// An error that states a problem with a report, and what to do.
pub(in crate::files::export) fn invalid(path: &Path, problem: impl std::fmt::Display) -> Error {
    Error::file(path, format!("is no report of results ({problem}); solve again, or give the folder of another solve"))
}

/// Reads a JSON file.
pub(in crate::files::export) fn read_json(path: &Path) -> Result<Value, Error> {
    let text = bounded_read::text(path, MAX_BYTES).map_err(|e| invalid(path, format!("it cannot be read: {e}")))?;
    serde_json::from_str(&text).map_err(|e| invalid(path, e))
}

/// The strings of an array.
pub(in crate::files::export) fn strings(value: &Value) -> impl Iterator<Item = &str> {
    value.as_array().into_iter().flatten().filter_map(Value::as_str)
}

/// Whether a name is a plain file name, without folders.
pub(in crate::files::export) fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let only = (parts.next(), parts.next());
    matches!(only, (Some(Component::Normal(part)), None) if part == name) && !name.contains(['/', '\\', '\0'])
}

#[cfg(test)]
mod tests {
    #[test]
    fn negative_zero_becomes_zero_and_other_values_are_written_as_by_serde_json() {
        let value = serde_json::json!({"a": [1.5, -2.0, {"b": []}], "c": {}, "d": "-0.0", "e": null});
        assert_eq!(super::to_json(&value).unwrap(), serde_json::to_string_pretty(&value).unwrap());
        assert_eq!(super::to_json(&[-0.0f64, -1e-300]).unwrap(), "[\n  0.0,\n  -1e-300\n]");
        assert_eq!(super::to_json(&-0.0f32).unwrap(), "0.0");
    }
}
