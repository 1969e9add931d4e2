//! The index page of a batch: one card per result, the worst first, with a small picture and a link.

use image::RgbImage;

use super::figure::resized;
use super::report_html::jpeg;

/// Width of a small picture, px.
const WIDTH: u32 = 320;

/// Greatest number of entries with a picture. A page with more would open slowly.
const MAX_PICTURES: usize = 500;

/// One pair or sweep.
#[derive(Clone, Debug, Default)]
pub struct Entry {
    /// Name of the entry; any text.
    pub name: String,
    /// "solved", "kept", "failed" or "not done".
    pub status: String,
    /// Numbers as text.
    pub facts: Vec<String>,
    /// Warnings and errors.
    pub warnings: Vec<String>,
    /// Rank of the entry. The greatest rank comes first; 0 means no problem.
    pub badness: f64,
    /// Link from the index to the entry's page.
    pub page: Option<String>,
    /// Picture of the depth.
    pub picture: Option<RgbImage>,
}

/// Writes the page. Its beginning identifies it as a page of `parfocal batch`.
pub fn batch_page(title: &str, sentence: &str, mut entries: Vec<Entry>) -> String {
    entries.sort_by(|a, b| b.badness.total_cmp(&a.badness));
    let (title, sentence) = (text(title), text(sentence));
    let picture = |(n, entry): (usize, &Entry)| card(entry, entry.picture.as_ref().filter(|_| n < MAX_PICTURES));
    let cards: String = entries.iter().enumerate().map(picture).collect();
    let header = format!("<h1>{title}</h1>\n<p class=\"sentence\">{sentence}</p>");
    document("parfocal batch", &format!("{title} – parfocal batch"), "", &header, &format!("<ul>\n{cards}</ul>\n"))
}

/// A page without scripts, which loads nothing. All texts are HTML; `style` is added to [`STYLE`].
pub(super) fn document(generator: &str, title: &str, style: &str, header: &str, main: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"generator\" content=\"{generator}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">\n\
         <title>{title}</title>\n<style>{STYLE}{style}</style>\n</head>\n<body>\n<header>{header}</header>\n\
         <main>\n{main}</main>\n</body>\n</html>\n"
    )
}

fn card(entry: &Entry, picture: Option<&RgbImage>) -> String {
    let kind = if entry.badness > 0.0 { "bad" } else { "good" };
    let picture = picture.and_then(small).map_or("<div class=\"none\"></div>".to_string(), |jpeg| {
        format!("<img alt=\"Depth of {}\" src=\"data:image/jpeg;base64,{jpeg}\">", text(&entry.name))
    });
    let name = match &entry.page {
        Some(page) => format!("<a href=\"{}\">{}</a>", text(page), text(&entry.name)),
        None => text(&entry.name),
    };
    let list = |class: &str, lines: &[String]| {
        lines.iter().fold(String::new(), |all, line| all + &format!("<p class=\"{class}\">{}</p>", text(line)))
    };
    format!(
        "<li class=\"{kind}\">{picture}<div><h2>{name}</h2><p class=\"status\">{}</p>{}{}</div></li>\n",
        text(&entry.status),
        list("fact", &entry.facts),
        list("warning", &entry.warnings)
    )
}

fn small(picture: &RgbImage) -> Option<String> {
    let (width, height) = picture.dimensions();
    let factor = (f64::from(WIDTH) / f64::from(width.max(1))).min(1.0);
    let side = |length: u32| ((f64::from(length) * factor).round() as u32).max(1);
    jpeg(&resized(picture, (side(width), side(height))), 80).ok()
}

/// Escapes text for HTML elements and attributes.
pub(super) fn text(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            c => escaped.push(c),
        }
    }
    escaped
}

/// The style of pages without scripts.
const STYLE: &str = "
:root { color-scheme: light dark; --page: light-dark(#f4f5f6, #15181b); --panel: light-dark(#fff, #1d2125);
  --line: light-dark(#dcdfe3, #32383e); --text: light-dark(#1c2126, #e6e9ec); --soft: light-dark(#545e69, #a3adb7);
  --accent: light-dark(#0b63a5, #6cb4ee); --bad: light-dark(#a85400, #f0a657); --good: light-dark(#1d7a46, #5ecb8f);
  font: 15px/1.45 system-ui, sans-serif; }
body { margin: 0; background: var(--page); color: var(--text); }
header, main { max-width: 1500px; margin: 0 auto; padding: 0 16px 12px; }
h1 { font-size: 16px; font-weight: 500; color: var(--soft); margin: 14px 0 4px; overflow-wrap: anywhere; }
.sentence { font-size: 21px; font-weight: 550; margin: 0; }
ul { list-style: none; margin: 0; padding: 0; display: grid; gap: 12px; grid-template-columns: repeat(auto-fill, minmax(260px, 1fr)); }
li { background: var(--panel); border: 1px solid var(--line); border-top: 4px solid var(--good); border-radius: 10px; overflow: hidden; }
li.bad { border-top-color: var(--bad); }
li div { padding: 4px 14px 12px; overflow-wrap: anywhere; }
img, .none { display: block; width: 100%; height: 180px; object-fit: contain; background: light-dark(#eceef0, #121417); padding: 0; }
h2 { font-size: 17px; margin: 6px 0 0; }
a { color: var(--accent); display: inline-block; padding: 10px 0; }
p { margin: 2px 0; } .status { font-weight: 600; } .fact { color: var(--soft); } .warning { color: var(--bad); font-size: 13.5px; }
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_comes_first_and_names_are_escaped() {
        let entry = |name: &str, badness| Entry { name: name.to_string(), badness, ..Entry::default() };
        let odd = "<img src=x onerror=alert(1)>\"'&";
        let picture = Some(RgbImage::new(700, 300));
        let page =
            batch_page(odd, "All.", vec![entry("good", 0.0), Entry { picture, ..entry(odd, 2.0) }, entry("bad", 1.0)]);
        assert!(!page.contains("<img src=x") && page.contains("&lt;img src=x onerror=alert(1)&gt;&quot;&#39;&amp;"));
        let at = |name: &str| page.find(&format!("<h2>{name}")).unwrap();
        assert!(at("&lt;img") < at("bad") && at("bad") < at("good"));
        assert!(page.starts_with("<!doctype html>") && page.contains("parfocal batch") && page.len() < 20_000);
    }
}
