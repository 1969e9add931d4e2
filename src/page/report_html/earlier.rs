//! The pictures of a page that is there, for the one that takes its place when its results are told anew.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use super::{
    COLORMAPS, Contents, Picture, Pixels, Readout, fields_of_pair, fields_of_sweep, residual, through_lens, to_scale,
};
use crate::files::bounded_read;
use crate::files::export::{Extra, PAGE_FILE, Palette, Solved, SolvedSweep};

/// The most bytes of a page that are read, 256 MiB: one of 4 megapixels with a hundred frames has a fifth of them.
const MAX_BYTES: u64 = 256 << 20;

/// What `report.html` holds that no file beside it does: the photographs, and what they are called. With it the page is
/// made anew from the folder alone, wherever the photographs are by now.
#[derive(Clone, Debug, PartialEq)]
pub struct EarlierPage {
    stated: Stated,
    /// JPEG in base64.
    pictures: Vec<String>,
}

/// What of the page's data stays as it is.
#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Stated {
    names: [String; 2],
    compare: [usize; 2],
    #[serde(default)]
    colormap: usize,
    pictures: Vec<String>,
}

impl EarlierPage {
    /// The page of a folder of results; `None` where there is none, or one of which the pictures cannot be had.
    pub fn read(folder: &Path) -> Option<Self> {
        let text = bounded_read::text(&folder.join(PAGE_FILE), MAX_BYTES).ok()?;
        let mut rest = text.as_str();
        let stated: Stated = serde_json::from_str(element(&mut rest, "application/json", "data")?).ok()?;
        let pictures = (0..stated.pictures.len()).map(|i| {
            let found = element(&mut rest, "text/plain", &format!("picture-{i}"))?;
            found.bytes().all(|b| b.is_ascii_alphanumeric() || b"+/=".contains(&b)).then(|| found.to_string())
        });
        let pictures: Vec<String> = pictures.collect::<Option<_>>()?;
        let is_whole = stated.compare.iter().all(|i| *i < pictures.len());
        is_whole.then_some(Self { stated, pictures })
    }

    /// The page of a pair, as its folder tells it now; in the colours that it has, unless others are given.
    pub fn of_pair<'a>(&'a self, solved: &'a Solved, palette: Option<Palette>) -> Extra<'a> {
        Extra::new(PAGE_FILE, move |writer| {
            let residual_values = solved.residual().map_err(|e| e.to_string())?;
            let mut fields = fields_of_pair(
                [&solved.relative_blur, &solved.uncertainty, &solved.confidence],
                solved.nearer,
                solved.metric.as_ref(),
            );
            fields.push(residual(&residual_values));
            let heights = if solved.metric.is_some() { "depth" } else { "relative_blur" };
            let told = json!({
                "kind": "pair", "names": self.stated.names, "compare": self.stated.compare, "report": solved.report(),
                "lens": through_lens(solved.transform.scale(), solved.limit(), solved.metric.as_ref()),
            });
            let contents = self.contents((solved.width, solved.height), palette, fields, heights, told);
            Contents { to_scale: to_scale(solved.metric.as_ref()), ..contents }.write(writer)
        })
    }

    /// The same of a focus sweep.
    pub fn of_sweep<'a>(&'a self, solved: &'a SolvedSweep, palette: Option<Palette>) -> Extra<'a> {
        Extra::new(PAGE_FILE, move |writer| {
            let sweep = &solved.sweep;
            let told = json!({
                "kind": "sweep", "names": self.stated.names, "compare": self.stated.compare, "frames": sweep.positions.len(),
                "report": solved.report(),
            });
            let fields = fields_of_sweep(sweep, solved.nearer);
            let heights = if sweep.depth.is_some() { "depth" } else { "focus" };
            self.contents((sweep.width, sweep.height), palette, fields, heights, told).write(writer)
        })
    }

    fn contents<'a>(
        &'a self,
        size: (u32, u32),
        palette: Option<Palette>,
        fields: Vec<Readout<'a>>,
        heights: &'static str,
        told: Value,
    ) -> Contents<'a> {
        let pictures = self.stated.pictures.iter().cloned().zip(&self.pictures);
        let pictures = pictures.map(|(name, text)| Picture { name, pixels: Pixels::Packed(text) }).collect();
        let palette = palette.or(COLORMAPS.get(self.stated.colormap).map(|(_, palette)| *palette)).unwrap_or_default();
        Contents { size, palette, pictures, fields, heights, to_scale: None, told }
    }
}

/// What the element of a type and a name holds, the first in what is left of a page; what comes after it is left.
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

    fn read(page: &str) -> Option<EarlierPage> {
        let folder = tempfile::TempDir::new().unwrap();
        fs::write(folder.path().join(PAGE_FILE), page).unwrap();
        EarlierPage::read(folder.path())
    }

    #[test]
    fn the_pictures_of_a_page_come_back_and_of_anything_else_nothing() {
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
        assert_eq!(EarlierPage::read(Path::new("/nowhere")), None);
    }
}
