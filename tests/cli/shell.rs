//! Shell integration: configuration, completions, manual pages and suggestions. No test solves a pair.

use crate::desk::{Desk, assert_refused, stderr_of};

fn desk() -> Desk {
    let desk = Desk::new();
    image::GrayImage::new(64, 48).save(desk.path("near.png")).unwrap();
    image::GrayImage::new(64, 48).save(desk.path("far.png")).unwrap();
    desk
}

#[track_caller]
fn refuses(desk: &Desk, arguments: &[&str], status: i32, part: &str) {
    let output = desk.run(arguments);
    assert_refused(&output, status, &[part]);
    assert!(stderr_of(&output).starts_with("error: ") && !desk.has("out"), "{}", stderr_of(&output));
}

#[test]
fn configuration_errors_name_file_and_line() {
    let desk = desk();
    let solve = ["solve", "near.png", "far.png", "-o", "out", "--config", "c.toml"];
    for (text, part) in [
        ("\nregularisation = 0.1\n", "c.toml:2: there is no option 'regularisation'; did you mean 'regularization'?"),
        ("relaxation-sweeps = 'many'\n", "c.toml:1: relaxation-sweeps must be a number, and is a string"),
        ("\n\nrelaxation-sweeps = 0\n", "c.toml:3: --relaxation-sweeps is 0, and must be 1 to 100"),
        ("smoothness_eta = 999\n", "c.toml:1: --smoothness-eta is 999"),
        ("kernel = 'none.png'\n", "none.png"),
    ] {
        desk.write("c.toml", text);
        refuses(&desk, &solve, 2, part);
    }
    desk.write("c.toml", "relaxation-sweeps = 0\n");
    refuses(&desk, &[&solve[..], &["--relaxation-sweeps", "101"]].concat(), 2, "--relaxation-sweeps is 101");
    refuses(&desk, &["register", "near.png", "far.png", "--config", "d.toml"], 1, "d.toml: ");
}

#[test]
fn the_printed_defaults_are_valid_toml() {
    let output = Desk::new().run(&["config"]);
    let text = String::from_utf8(output.stdout).unwrap();
    let table: toml::Table = toml::from_str(&text).unwrap();
    for name in ["over-relaxation", "continuation", "data-eta", "smoothness-eta", "largest-step"] {
        assert!(table[name].is_float() || table[name].is_integer(), "{name}");
    }
}

#[test]
fn completions_and_manual_pages_are_generated() {
    let desk = desk();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = desk.run(&["completions", shell]);
        assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("max-relative-blur"));
    }
    let page = desk.run(&["man"]);
    assert!(String::from_utf8_lossy(&page.stdout).contains(".TH parfocal 1"));
    assert!(desk.run(&["man", "-o", "pages"]).status.success());
    let solve = desk.text("pages/parfocal-solve.1");
    assert!(solve.contains(".TH parfocal-solve 1") && solve.contains("parfocal solve"), "{solve}");
    assert!(desk.path("pages/parfocal.1").is_file());
}

#[test]
fn without_arguments_the_first_steps_are_printed() {
    let steps = stderr_of(&Desk::new().exits(&[], 2));
    for command in ["solve near.png far.png", "stack FOLDER", "batch FOLDER", "open out"] {
        assert!(steps.contains(&format!("parfocal {command}")), "{steps}");
    }
}

#[test]
fn a_misspelled_name_gets_a_suggestion() {
    let desk = desk();
    refuses(&desk, &["solve", "naer.png", "far.png", "-o", "out"], 1, "did you mean 'near.png'?");
    refuses(&desk, &["solve", "near.png", "far.png", "-o", "near.png"], 1, "'near' say");
    refuses(&desk, &["slove"], 2, "'solve'");
}

#[cfg(unix)]
#[test]
fn what_is_no_folder_of_a_sweep_is_named() {
    let desk = desk();
    std::fs::create_dir(desk.path("shots")).unwrap();
    desk.write("shots/DSC_1.NEF", "II*\0");
    desk.write("shots.zip", "PK\x03\x04");
    std::os::unix::fs::symlink("gone.png", desk.path("link.png")).unwrap();
    for (argument, expected) in [
        ("shotz", "there is no such file or folder; did you mean 'shots'?"),
        ("shots", "it holds 1 of another kind: DSC_1.NEF is a raw file (NEF), which is not read: convert"),
        ("shots.zip", "is an archive (ZIP): extract it"),
        ("*.png", "is a pattern that no file matches, or that is quoted"),
        ("link.png", "is a link to 'gone.png', which does not exist"),
        ("near.png", "is one photograph, and a sweep has three or more"),
    ] {
        refuses(&desk, &["stack", argument, "-o", "out"], 1, expected);
    }
}

#[cfg(unix)]
#[test]
fn network_paths_of_windows_and_urls_are_refused() {
    let desk = desk();
    let (share, url) = (r"\\server\share\a.png", "file:///photographs/a.png");
    let [mount, path] = ["is a network path of Windows; mount it", "is a URL; give the path"];
    desk.write("share.toml", r"golden = '\\server\share\golden.exr'");
    for (arguments, expected) in [
        (&["solve", share, "far.png", "-o", "out"][..], mount),
        (&["solve", url, "far.png", "-o", "out"], path),
        (&["solve", "near.png", "far.png", "-o", share], mount),
        (&["solve", "near.png", "far.png", "-o", "smb://server/out"], path),
        (&["batch", share, "-o", "out"], mount),
        (&["watch", url, "-o", "out"], path),
        (&["batch", ".", "-o", "out", "--config", "share.toml"], mount),
        (&["batch", ".", "-o", "out", "--log", url], path),
    ] {
        refuses(&desk, arguments, 1, expected);
    }
    assert_eq!(std::fs::read_dir(desk.folder()).unwrap().count(), 3);
}

#[test]
fn without_a_driver_the_list_holds_the_processor() {
    let desk = desk();
    let run = |arguments: &[&str]| {
        let no_driver = desk.path("no-driver.json");
        desk.command(arguments)
            .env("VK_DRIVER_FILES", &no_driver)
            .env("VK_ICD_FILENAMES", &no_driver)
            .assert()
            .success()
    };
    let devices: serde_json::Value = serde_json::from_slice(&run(&["devices", "--json"]).get_output().stdout).unwrap();
    assert_eq!((devices.as_array().unwrap().len(), devices[0]["name"].as_str()), (1, Some("cpu")), "{devices}");
    run(&["devices", "-q"]).stdout("cpu\n");
    // Its index in the list opens it.
    run(&["simulate", "plane", "--size", "80x64", "-o", "scene"]);
    run(&["register", "scene/i1.png", "scene/i2.png", "--device", "0"]);
}

#[test]
fn each_subcommand_states_the_version() {
    let desk = desk();
    for arguments in [&["--version"][..], &["solve", "--version"], &["devices", "-V"]] {
        let output = desk.run(arguments);
        assert!(output.status.success(), "{arguments:?}");
        assert!(String::from_utf8_lossy(&output.stdout).trim_end().ends_with(env!("CARGO_PKG_VERSION")), "{output:?}");
    }
}
