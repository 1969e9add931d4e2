//! Fuzz tests of the files of options, lists, lenses and regions.

use crate::cli::batch::pairs;
use crate::cli::commands::calibrate;
use crate::cli::options::config_file;
use crate::cli::options::lens;
use crate::cli::options::study_table;
use harness::{Share, Target};

#[path = "../../tests/common/fuzz.rs"]
mod harness;
#[path = "../../tests/common/trust.rs"]
mod trust;

fn target(name: &'static str, file: &'static str, corpus: &[&str], read: fn(&std::path::Path)) -> Target {
    Target { name, file, corpus: corpus.iter().map(|text| text.as_bytes().to_vec()).collect(), read }
}

#[test]
fn text_files_of_any_content_are_read_or_refused() {
    let config = [
        "# comment\nouter-iterations = 40\nmethod = \"unified\"\n\"start\" = 'x'\ngain = 1.5e-3\nno-html = true\n",
        "profile = [\"1,2,3,4\", \"5,6,7,8\"]\n[table]\na.b = 0x1F\nd = 1979-05-27T07:32:00Z\n",
    ];
    let list = [
        "i1,i2,name\na.png,b.png,first\n\"a, b.png\",c.tif#2,\"sec\"\"ond\"\n",
        "{\"i1\": \"a.png\", \"i2\": \"b.png\", \"name\": \"one\"}\n{\"sweep\": \"folder\", \"name\": \"two\"}\n",
    ];
    let lens = [
        r#"{"focal_length_mm": 25, "f_number": 4, "pixel_pitch_mm": 0.013, "focus_mm": [500, 900], "telecentric": true}"#,
        r#"{"depth": {"lens": {"focal_length_mm": 50.0, "f_number": 2.8, "pixel_pitch_mm": 5e-3, "focus_mm": [1e3, 2e3]}}}"#,
    ];
    let steps = [r#"[{"region": [10, 20, 30, 40], "depth_mm": 512.5}, {"region": [0, 0, 8, 8], "depth_mm": 7e2}]"#];
    let study = ["operator,part,trial,value_mm\nA,1,1,0.5\nA,1,2,-1e-3\n", "part;results\n1;first\n2;\"sec;ond\"\n"];
    let targets = [
        target("config", "options.toml", &config, config_file::reads),
        target("list", "list.csv", &list, pairs::reads),
        target("lens", "lens.json", &lens, lens::reads),
        target("study", "study.csv", &study, study_table::reads),
        target("steps", "steps.json", &steps, calibrate::reads),
    ];
    // A case takes some 20 µs.
    harness::run(
        "cli::fuzz::text_files_of_any_content_are_read_or_refused",
        &targets,
        &Share { short: 5000, long: 100_000 },
    );
}
