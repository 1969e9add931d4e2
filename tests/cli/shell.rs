//! Shell integration: configuration, completions, manual pages and suggestions. No test solves a pair.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use tempfile::TempDir;

struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        image::GrayImage::new(64, 48).save(desk.path("near.png")).unwrap();
        image::GrayImage::new(64, 48).save(desk.path("far.png")).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::cargo_bin("parfocal").unwrap().current_dir(self.0.path()).args(arguments).output().unwrap()
    }

    #[track_caller]
    fn refuses(&self, arguments: &[&str], status: i32, part: &str) {
        let output = self.run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{stderr}");
        assert!(stderr.starts_with("error: ") && stderr.contains(part), "{stderr}");
        assert!(!self.path("out").exists());
    }
}

#[test]
fn configuration_errors_name_file_and_line() {
    let desk = Desk::new();
    let solve = ["solve", "near.png", "far.png", "-o", "out", "--config", "c.toml"];
    for (text, part) in [
        ("\nregularisation = 0.1\n", "c.toml:2: there is no option 'regularisation'; did you mean 'regularization'?"),
        ("relaxation-sweeps = 'many'\n", "c.toml:1: relaxation-sweeps must be a number, and is a string"),
        ("\n\nrelaxation-sweeps = 0\n", "c.toml:3: --relaxation-sweeps is 0, and must be 1 to 100"),
        ("heaviside_epsilon = 99\n", "c.toml:1: --heaviside-epsilon is 99"),
        ("kernel = 'none.png'\n", "none.png"),
    ] {
        fs::write(desk.path("c.toml"), text).unwrap();
        desk.refuses(&solve, 2, part);
    }
    fs::write(desk.path("c.toml"), "relaxation-sweeps = 0\n").unwrap();
    desk.refuses(&[&solve[..], &["--relaxation-sweeps", "101"]].concat(), 2, "--relaxation-sweeps is 101");
    desk.refuses(&["register", "near.png", "far.png", "--config", "d.toml"], 1, "d.toml: ");
}

#[test]
fn the_printed_defaults_are_valid_toml() {
    let output = Desk::new().run(&["config"]);
    let text = String::from_utf8(output.stdout).unwrap();
    let table: toml::Table = toml::from_str(&text).unwrap();
    for name in ["over-relaxation", "continuation", "data-eta", "smoothness-eta", "heaviside-epsilon", "largest-step"] {
        assert!(table[name].is_float() || table[name].is_integer(), "{name}");
    }
}

#[test]
fn completions_and_manual_pages_are_generated() {
    let desk = Desk::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = desk.run(&["completions", shell]);
        assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("max-relative-blur"));
    }
    let page = desk.run(&["man"]);
    assert!(String::from_utf8_lossy(&page.stdout).contains(".TH parfocal 1"));
    assert!(desk.run(&["man", "-o", "pages"]).status.success());
    let solve = fs::read_to_string(desk.path("pages/parfocal-solve.1")).unwrap();
    assert!(solve.contains(".TH parfocal-solve 1") && solve.contains("parfocal solve"), "{solve}");
    assert!(desk.path("pages/parfocal.1").is_file());
}

#[test]
fn a_misspelled_name_gets_a_suggestion() {
    let desk = Desk::new();
    desk.refuses(&["solve", "naer.png", "far.png", "-o", "out"], 1, "did you mean 'near.png'?");
    desk.refuses(&["solve", "near.png", "far.png", "-o", "near.png"], 1, "'near' say");
    desk.refuses(&["slove"], 2, "'solve'");
}

#[test]
fn without_a_driver_the_list_holds_the_processor() {
    let desk = Desk::new();
    let mut command = Command::cargo_bin("parfocal").unwrap();
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(name, desk.path("no-driver.json"));
    }
    let output = command.args(["devices", "--json"]).output().unwrap();
    let devices: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(output.status.success());
    assert_eq!((devices.as_array().unwrap().len(), devices[0]["name"].as_str()), (1, Some("cpu")), "{devices}");
    let mut names = Command::cargo_bin("parfocal").unwrap();
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        names.env(name, desk.path("no-driver.json"));
    }
    names.args(["devices", "-q"]).assert().success().stdout("cpu\n");
}

#[test]
fn each_subcommand_states_the_version() {
    let desk = Desk::new();
    for arguments in [&["--version"][..], &["solve", "--version"], &["devices", "-V"]] {
        let output = desk.run(arguments);
        assert!(output.status.success(), "{arguments:?}");
        assert!(String::from_utf8_lossy(&output.stdout).trim_end().ends_with(env!("CARGO_PKG_VERSION")), "{output:?}");
    }
}
