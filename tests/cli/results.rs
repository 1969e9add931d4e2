//! Commands on existing results: a pair, a sweep, and results of a batch.

use crate::browser::Browser;
use crate::desk::{Desk, assert_fails, stderr_of};

/// Returns a folder with the results of a batch of a valid pair, a pair that fails, and a sweep.
fn desk() -> Desk {
    let desk = Desk::new();
    for name in ["first", "second"] {
        desk.done(&["simulate", "relief", "-o", &format!("shots/{name}"), "--size", "120x90"]);
    }
    desk.write("shots/second/i2.png", "no picture");
    desk.done(&["simulate", "relief", "-o", "shots/sweep <b>", "--size", "120x90", "--frames", "4"]);
    desk.exits(&["batch", "shots", "-o", "many"], 1);
    desk
}

#[test]
fn commands_accept_batch_results_and_the_index_lists_failures_first() {
    let desk = desk();
    let lens = ["--focal-length=50", "--f-number=5.6", "--pixel-pitch=0.00345", "--focus=226.5,233.5"];
    desk.done(&["view", "many/first", "--width", "64"]);
    desk.done(&["measure", "many/first", "--step", "10,10,30,30", "60,40,30,30"]);
    desk.done(&[&["depth", "many/first"], &lens[..]].concat());
    desk.done(&["measure", "many/sweep <b>", "--profile", "10,20,90,20"]);
    desk.done(&["depth", "many/sweep <b>", "--focus-at", "1,2,3,4", "--stage"]);
    let calibrate = ["calibrate", "many/sweep <b>", "--known", "1,1,20,20=5", "--kappa", "0.5"];
    assert_fails(&desk.run(&calibrate), &["holds a focus sweep"]);
    assert_fails(&desk.run(&["view", "many"]), &["results of a batch", "one pair or sweep"]);

    let mut browser = Browser::start(1400, 900);
    browser.open(&desk.path("many/index.html"), "document.querySelectorAll('li').length === 3");
    let names = browser.evaluate("[...document.querySelectorAll('h2')].map(h => h.textContent).join()");
    assert!(names.as_str().unwrap().starts_with("second,"), "{names}");
    assert_eq!(browser.evaluate("document.querySelectorAll('li.bad .warning').length > 0"), true);
    assert_eq!(browser.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 50)"), true);
    assert_eq!(browser.evaluate("document.images.length"), 2);
    let sentence = browser.evaluate("document.querySelector('.sentence').textContent");
    assert_eq!(sentence, "2 solved, none of them with warnings or not converged; 1 failed or not done.");
    browser.evaluate("[...document.links].find(a => a.textContent.startsWith('sweep')).click()");
    browser.wait("window.page");
    assert_eq!(browser.complaints(), Vec::<String>::new());

    // A batch replaces its own index.html, but not a foreign one.
    desk.run(&["batch", "shots", "-o", "many", "--resume"]);
    desk.write("many/index.html", "mine");
    assert_fails(&desk.run(&["batch", "shots", "-o", "many"]), &["index.html", "--force"]);
}

#[cfg(unix)]
#[test]
fn open_passes_the_page_to_the_system_opener() {
    let desk = desk();
    desk.write_script("bin/xdg-open", &format!("echo \"$1\" > '{}'\n", desk.path("opened").display()));
    for (folder, page) in [("many/first", "many/first/report.html"), ("many", "many/index.html")] {
        let mut command = desk.command(&["open", folder]);
        command.env("PATH", format!("{}:/bin:/usr/bin", desk.path("bin").display()));
        assert!(command.output().unwrap().status.success());
        assert_eq!(desk.text("opened").trim(), page);
        assert_eq!(String::from_utf8(desk.done(&["open", folder, "--print"]).stdout).unwrap().trim(), page);
    }
    // Photographs without a command.
    let mut dropped = desk.command(&["shots/first/i1.png", "shots/first/i2.png"]);
    dropped.env("PATH", format!("{}:/bin:/usr/bin", desk.path("bin").display()));
    assert!(dropped.output().unwrap().status.success());
    assert_eq!(desk.text("opened").trim(), "shots/first/i1-depth/report.html");
    let mut without = desk.command(&["open", "many"]);
    let output = without.env("PATH", "/nowhere").output().unwrap();
    assert!(stderr_of(&output).contains("open many/index.html in a browser"), "{}", stderr_of(&output));
    assert_fails(&desk.run(&["open", "shots"]), &["has no page"]);
    assert_fails(&desk.run(&["open", "absent"]), &["no folder"]);
}

#[test]
fn two_results_are_compared_in_standard_deviations() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "pair", "--size", "120x90", "--noise", "0.01"]);
    let solve = |out: &str, extra: &[&str]| {
        desk.done(&[&["solve", "pair/i1.png", "pair/i2.png", "-o", out, "--no-html"], extra].concat());
    };
    solve("a", &[]);
    solve("b", &["--regularization", "0.01"]);
    let compare = |a: &str, b: &str| desk.printed(&["compare", a, b, "-o", "off.png", "-q"]);
    let same = compare("a", "a");
    assert_eq!((&same["settings"].as_array().unwrap().len(), &same["difference"]["rms"]), (&0, &0.0.into()));
    let found = compare("a", "b");
    let [name, values] = [&found["settings"][0][0], &found["settings"][0][1]];
    assert_eq!((name, &values[1]), (&"regularization".into(), &0.01.into()));
    let off = &found["difference"];
    // Compute the same figures from the EXR files.
    let field = |out: &str, name: &str| parfocal::image_io::read_field(&desk.path(out).join(name)).unwrap().2;
    let [a, b] = ["a", "b"].map(|out| (field(out, "relative_blur.exr"), field(out, "uncertainty.exr")));
    let pixels = off["pixels"].as_u64().unwrap() as usize;
    let finite = a.0.iter().zip(&b.0).filter(|(x, y)| x.is_finite() && y.is_finite()).count();
    assert!(pixels > 5000 && pixels <= finite, "{off}");
    let mut sigmas: Vec<f64> = (0..a.0.len())
        .filter(|&i| a.0[i].is_finite() && b.0[i].is_finite())
        .map(|i| f64::from(b.0[i] - a.0[i]) / f64::from(a.1[i]).hypot(f64::from(b.1[i])))
        .collect();
    sigmas.sort_by(f64::total_cmp);
    assert!((off["median_sigmas"].as_f64().unwrap() - sigmas[sigmas.len() / 2]).abs() < 0.05, "{off}");
    assert!(off["rms_sigmas"].as_f64().unwrap() > 0.0);
    let picture = image::open(desk.path("off.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (120, 90));
    let output = desk.run(&["compare", "a", "b"]);
    assert!(
        stderr_of(&output).contains("regularization") && stderr_of(&output).contains("% beyond 3"),
        "{}",
        stderr_of(&output)
    );

    solve("part", &["--roi", "10,10,60,50"]);
    assert_fails(&desk.run(&["compare", "a", "part"]), &["120x90 and 60x50"]);
    desk.done(&["simulate", "relief", "-o", "sweep", "--size", "120x90", "--frames", "3"]);
    desk.done(&["stack", "sweep", "-o", "stacked", "--no-html"]);
    assert_fails(&desk.run(&["compare", "a", "stacked"]), &["nothing in common"]);
    assert_eq!(compare("stacked", "stacked")["quantity"], "focus");
}
