//! The page of results, from the photographs or from the pictures of the existing page.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use super::{COLORMAPS, Contents, Photographed, Picture, Pixels, Readout};
use crate::base::{Decode, Frame, Lens, Region};
use crate::files::bounded_read;
use crate::files::export::{Extra, Kind, PAGE_FILE, Palette, Results};
use crate::files::image_io::Tone;
use crate::page::view::relief_to_scale;

/// Greatest number of bytes of a page that are read, 256 MiB. A page of 4 megapixels with a hundred frames has a fifth
/// of that.
const MAX_BYTES: u64 = 256 << 20;

/// The page for new results, from the photographs and additional fields.
#[derive(Clone, Debug)]
pub struct Page<'a> {
    /// I1 and I2, or the frames of a sweep in the order of the report.
    pub photographs: Vec<&'a Frame>,
    /// Names of the photographs; any text.
    pub names: Vec<String>,
    /// Colours of near and far.
    pub palette: Palette,
    /// Additional fields.
    pub fields: Vec<Readout<'a>>,
}

impl<'a> Page<'a> {
    /// The page as a file for [`Results::write`].
    pub fn file(self) -> Extra<'a> {
        Extra::new(PAGE_FILE, move |results, writer| self.write(results, writer))
    }

    fn write(self, results: &Results<'_>, writer: &mut dyn Write) -> Result<(), String> {
        let report = &results.report;
        let (reference, decode, part) = (report.reference, report.values.decode, report.region);
        let is_pair = report.kind == Kind::Pair;
        // One range for all photographs, so that they can be compared.
        let tone = self.photographs.get(reference).map_or_else(Tone::default, |photograph| Tone::of(photograph));
        let mut pictures: Vec<Picture<'_>> = Vec::new();
        for (n, (photograph, name)) in self.photographs.iter().zip(&self.names).enumerate() {
            let is_reference = n == reference;
            let name = match (is_pair, is_reference) {
                (true, true) => format!("I1: {name}"),
                (true, false) => format!("I2 registered: {name}"),
                (false, true) => format!("{name} (reference)"),
                (false, false) => name.clone(),
            };
            let frame = report.frames.get(n).filter(|_| !is_reference);
            let registration = frame.map(|frame| (frame.transform, frame.brightness()));
            let sharing = (!is_pair && !is_reference).then(|| self.photographs.len() - 1);
            let frame = Cow::Borrowed(*photograph);
            pictures.push(Photographed { frame, decode, tone, part, registration, sharing }.named(name));
        }
        let compare = if is_pair { [0, 1] } else { [reference, pictures.len()] };
        let frame = results.fused_in_8_bits().map_err(|e| e.to_string())?;
        let part = Region { x: 0, y: 0, width: frame.width(), height: frame.height() };
        let frame = Cow::Borrowed(frame);
        let (decode, tone) = (Decode::None, Tone::default());
        let fused = Photographed { frame, decode, tone, part, registration: None, sharing: None };
        pictures.push(fused.named("Best focus".to_string()));
        let ends = [self.names.first(), self.names.last()].map(|name| name.cloned().unwrap_or_default());
        write(results, &ends, compare, pictures, self.palette, self.fields, writer)
    }
}

/// The pictures and names of an existing page. With them the page can be written again without the photographs.
#[derive(Clone, Debug, PartialEq)]
pub struct ExistingPage {
    data: PageData,
    /// The pictures, JPEG in base64.
    pictures: Vec<String>,
}

/// The data of a page that do not change.
#[derive(Clone, Debug, PartialEq, Deserialize)]
struct PageData {
    names: [String; 2],
    compare: [usize; 2],
    #[serde(default)]
    colormap: usize,
    pictures: Vec<String>,
}

impl ExistingPage {
    /// Reads the page of a folder; `None` if it is missing or its pictures cannot be read.
    pub fn read(folder: &Path) -> Option<Self> {
        let text = bounded_read::text(&folder.join(PAGE_FILE), MAX_BYTES).ok()?;
        let mut rest = text.as_str();
        let data: PageData = serde_json::from_str(element(&mut rest, "application/json", "data")?).ok()?;
        let pictures = (0..data.pictures.len()).map(|i| {
            let found = element(&mut rest, "text/plain", &format!("picture-{i}"))?;
            found.bytes().all(|b| b.is_ascii_alphanumeric() || b"+/=".contains(&b)).then(|| found.to_string())
        });
        let pictures: Vec<String> = pictures.collect::<Option<_>>()?;
        let is_whole = data.compare.iter().all(|i| *i < pictures.len());
        is_whole.then_some(Self { data, pictures })
    }

    /// The page for changed results. It keeps its colours unless others are passed.
    pub fn file(&self, palette: Option<Palette>) -> Extra<'_> {
        Extra::new(PAGE_FILE, move |results, writer| {
            let pictures = self.data.pictures.iter().cloned().zip(&self.pictures);
            let pictures = pictures.map(|(name, text)| Picture { name, pixels: Pixels::Encoded(text) }).collect();
            let own = || COLORMAPS.get(self.data.colormap).map(|(_, palette)| *palette);
            let palette = palette.or_else(own).unwrap_or_default();
            write(results, &self.data.names, self.data.compare, pictures, palette, Vec::new(), writer)
        })
    }
}

/// Writes the page of results.
fn write(
    results: &Results<'_>,
    names: &[String; 2],
    compare: [usize; 2],
    pictures: Vec<Picture<'_>>,
    palette: Palette,
    more: Vec<Readout<'_>>,
    writer: &mut dyn Write,
) -> Result<(), String> {
    let report = &results.report;
    let limit = report.blur_limit();
    let lens = results.lens().map(|_| json!({ "scale": results.magnification(), "limit": limit }));
    let frames = (report.kind == Kind::Sweep).then_some(report.frames.len());
    // Parsed from the report's text, so that floats have the same few digits as in the file.
    let text = report.to_json().and_then(|text| serde_json::from_str::<Value>(&text)).map_err(|e| e.to_string())?;
    let data = json!({
        "kind": report.kind, "names": names, "compare": compare, "lens": lens, "frames": frames, "report": text,
    });
    let (best, quantity, depth) = (results.best(), results.quantity(), results.depth());
    let confidence = results.field("confidence").ok();
    let residual = results.field("residual").ok();
    let values = &quantity.values[..];
    let principal = match quantity.name {
        "relative_blur" => Readout::relative_blur(values, quantity.nearer),
        _ => Readout::focus(values, quantity.nearer).unit(results.focus_unit()),
    };
    let principal = principal.rounded_by(&quantity.deviation).between(report.end_names());
    let sigma = match quantity.name {
        "relative_blur" => Readout::deviation("uncertainty", &principal, ["σ of V", "σ"], &quantity.deviation).note(
            "σ is the standard deviation of V, px², by what the images show around each pixel. It is 1000 where they \
             show nothing. The scale is logarithmic.",
        ),
        _ => Readout::deviation("uncertainty", &principal, ["σ of focus", "σ"], &quantity.deviation).note(
            "σ is the standard deviation of the focus setting, by what the pairs show. The scale is logarithmic.",
        ),
    };
    let mut fields = vec![principal, sigma];
    fields.extend(confidence.as_deref().map(|values| Readout::confidence(values).computed()));
    if let Some(depth) = &depth {
        let [values, sigma] = Readout::depth_with_deviation(&depth.values, &depth.deviation, depth.nearer);
        let values = values.between(report.end_names());
        // The page itself computes depth from a lens whose field is even.
        match results.lens() {
            Some(Lens { field: None, .. }) => fields.extend([values.computed(), sigma.computed()]),
            _ => fields.extend([values.rounded_by(&depth.deviation), sigma]),
        }
    }
    fields.extend(residual.as_deref().map(Readout::residual));
    // For the map alone, which draws it paler.
    let (scale, is_measured) = (best.scale(), results.best_measured().values);
    let nearness = |(v, measured): (&f32, &f32)| if measured.is_nan() { scale.nearness(*v) as f32 } else { f32::NAN };
    let filled: Vec<f32> = results.filled().iter().zip(&*is_measured).map(nearness).collect();
    fields.push(Readout::new("filled", "Filled in", "", &filled).digits(3));
    fields.extend(more);
    let (size, to_scale) =
        (results.size(), results.footprint().map(|footprint| relief_to_scale(&best, results.size(), footprint)));
    Contents { size, palette, pictures, fields, heights: best.name, to_scale, more: data }.write(writer)
}

/// The content of the first element of this type and this name in `rest`. Advances `rest` to the text after it.
fn element<'a>(rest: &mut &'a str, kind: &str, id: &str) -> Option<&'a str> {
    let (_, from) = rest.split_once(&format!("<script type=\"{kind}\" id=\"{id}\">"))?;
    let (found, after) = from.split_once("</script>")?;
    *rest = after;
    Some(found)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn read(page: &str) -> Option<ExistingPage> {
        let folder = tempfile::TempDir::new().unwrap();
        fs::write(folder.path().join(PAGE_FILE), page).unwrap();
        ExistingPage::read(folder.path())
    }

    #[test]
    fn pictures_of_a_page_are_read_and_other_files_are_refused() {
        let data = r#"{"names":["a","b"],"compare":[0,1],"pictures":["I1","I2"],"more":1}"#;
        let page = |data: &str, second: &str| {
            format!(
                "<html><script type=\"application/json\" id=\"data\">{data}</script>\n\
                 <script type=\"text/plain\" id=\"picture-0\">QUJD</script>\n\
                 <script type=\"text/plain\" id=\"picture-1\">{second}</script></html>"
            )
        };
        assert_eq!(read(&page(data, "Zm8=")).unwrap().pictures, ["QUJD", "Zm8="]);
        for bad in [page(data, "<!-- "), page("{}", ""), page(&data.replace("[0,1]", "[0,2]"), ""), String::new()] {
            assert_eq!(read(&bad), None, "{bad}");
        }
        assert_eq!(ExistingPage::read(Path::new("/nowhere")), None);
    }
}
