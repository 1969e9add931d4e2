//! JSON as every report is written: indented, and without negative zeros, which mean nothing there.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};

/// The text of a value, without a newline at its end.
///
/// # Errors
/// None is known for the reports; serde_json's signature allows one.
pub(crate) fn to_string(value: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut bytes = Vec::new();
    value.serialize(&mut Serializer::with_formatter(&mut bytes, Positive(PrettyFormatter::new())))?;
    String::from_utf8(bytes).map_err(serde::ser::Error::custom)
}

struct Positive(PrettyFormatter<'static>);

impl Formatter for Positive {
    fn write_f32<W: ?Sized + Write>(&mut self, writer: &mut W, value: f32) -> io::Result<()> {
        // Adding zero makes -0 positive and leaves every other number as it is.
        self.0.write_f32(writer, value + 0.0)
    }

    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        self.0.write_f64(writer, value + 0.0)
    }

    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_array(writer)
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_array(writer)
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.0.begin_array_value(writer, first)
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_array_value(writer)
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_object(writer)
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_object(writer)
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        self.0.begin_object_key(writer, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.begin_object_value(writer)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.0.end_object_value(writer)
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn negative_zero_is_zero_and_the_rest_is_as_serde_json_writes_it() {
        let value = serde_json::json!({"a": [1.5, -2.0, {"b": []}], "c": {}, "d": "-0.0", "e": null});
        assert_eq!(super::to_string(&value).unwrap(), serde_json::to_string_pretty(&value).unwrap());
        assert_eq!(super::to_string(&[-0.0f64, -1e-300]).unwrap(), "[\n  0.0,\n  -1e-300\n]");
        assert_eq!(super::to_string(&-0.0f32).unwrap(), "0.0");
    }
}
