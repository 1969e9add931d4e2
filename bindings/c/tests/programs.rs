//! Installs the library into a prefix, compiles the examples against it with warnings as errors, and runs them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use tempfile::TempDir;

/// The installed prefix, shared by all tests. The libraries are beside this test program, where cargo built them.
static PREFIX: LazyLock<TempDir> = LazyLock::new(|| {
    let prefix = TempDir::new().expect("a folder");
    let test = std::env::current_exe().expect("the path of this test");
    let built = test.parent().expect("the folder of this test");
    let mut install = Command::new(here().join("install"));
    done(&install.arg(prefix.path()).arg("dev").env("PARFOCAL_BUILT", built).output().expect("bash"));
    prefix
});

const STRICT: [&str; 4] = ["-Wall", "-Wextra", "-Werror", "-pedantic"];

fn here() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn words(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

/// Asserts that a command succeeded and returns its output.
fn done(output: &Output) -> String {
    assert!(output.status.success(), "{}: {}", output.status, words(output));
    words(output)
}

fn has(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
}

/// Compiles an example with the flags of the installed library.
fn compile(compiler: &str, source: &str, flags: &[&str]) -> PathBuf {
    let prefix = PREFIX.path();
    let name: String =
        [source].iter().chain(flags).flat_map(|part| part.chars()).filter(char::is_ascii_alphanumeric).collect();
    let program = prefix.join(name);
    let mut command = Command::new(compiler);
    command.args(STRICT).arg("-o").arg(&program).arg(here().join("examples").join(source));
    let (include, lib) = (prefix.join("include"), prefix.join("lib"));
    match flags.contains(&"-static-parfocal") {
        true => {
            command.arg("-I").arg(include).arg(lib.join("libparfocal.a")).args(["-lm", "-ldl", "-lpthread", "-lgcc_s"])
        }
        false => command.args(library_flags(&include, &lib)).arg(format!("-Wl,-rpath,{}", lib.display())).arg("-lm"),
    };
    command.args(flags.iter().filter(|flag| **flag != "-static-parfocal"));
    done(&command.output().expect("a compiler"));
    program
}

/// Returns the compiler flags of pkg-config, or the same flags if pkg-config is missing.
fn library_flags(include: &Path, lib: &Path) -> Vec<String> {
    if !has("pkg-config") {
        return vec![format!("-I{}", include.display()), format!("-L{}", lib.display()), "-lparfocal".to_string()];
    }
    let mut command = Command::new("pkg-config");
    let query = command.env("PKG_CONFIG_PATH", lib.join("pkgconfig")).args(["--cflags", "--libs", "parfocal"]);
    done(&query.output().expect("pkg-config")).split_whitespace().map(str::to_string).collect()
}

#[test]
fn c_solves_a_pair() {
    for flags in [&["-std=c11"][..], &["-std=c11", "-static-parfocal"]] {
        let output = done(&Command::new(compile("cc", "solve.c", flags)).output().expect("the program"));
        assert!(output.contains("V in the middle 1.00") && output.contains("T 0.800 -0.600 px, converged"), "{output}");
    }
}

#[test]
fn cpp_solves_registers_streams_and_stacks() {
    let output = done(&Command::new(compile("c++", "solve.cpp", &["-std=c++17"])).output().expect("the program"));
    let parts = [
        "V in the middle 1.00",
        "the solve was cancelled\n",
        "from 12 bits, V in the middle 1.00",
        "depth in the middle 30",
        "line of 57",
        "24x16 px from 32, 40",
        "T 0.799",
        "9 of 9 pairs",
        "at 1.99",
        "px to the right",
        "Sq 0.",
        "the noise of a map is 0.",
    ];
    assert!(parts.iter().all(|part| output.contains(part)), "{output}");
}

#[test]
fn the_library_does_not_leak_and_a_leak_is_detected() {
    // Leaks of drivers and layers have no stack frame of this library.
    let leaks = |flags: &[&str]| {
        let program = compile("cc", "solve.c", &[&["-std=c11", "-g", "-fsanitize=address,undefined"], flags].concat());
        let output = words(&Command::new(program).env("ASAN_OPTIONS", "detect_leaks=1").output().expect("the program"));
        assert!(output.contains("converged") && !output.contains("runtime error"), "{output}");
        assert!(
            output.matches("ERROR: ").count() == output.matches("ERROR: LeakSanitizer: detected memory leaks").count(),
            "{output}"
        );
        output
            .replace("libparfocal", "")
            .lines()
            .filter(|line| line.contains(" in ") && line.contains("parfocal"))
            .count()
    };
    assert_eq!(leaks(&[]), 0);
    assert!(leaks(&["-DFORGET_THE_SOLUTION"]) > 0);
}

#[test]
fn cmake_finds_the_package() {
    if !has("cmake") {
        println!("cmake is missing: the test is skipped");
        return;
    }
    let (project, prefix) = (TempDir::new().expect("a folder"), PREFIX.path());
    let text = format!(
        "cmake_minimum_required(VERSION 3.16)\nproject(found C CXX)\nset(CMAKE_CXX_STANDARD 17)\n\
         find_package(parfocal 0.1 REQUIRED)\nadd_executable(found {0}/solve.cpp)\n\
         target_link_libraries(found parfocal::parfocal)\nadd_executable(static {0}/solve.c)\n\
         target_link_libraries(static parfocal::static)\n",
        here().join("examples").display()
    );
    std::fs::write(project.path().join("CMakeLists.txt"), text).expect("a file");
    let run = |arguments: &[&str]| {
        let cmake = Command::new("cmake").args(arguments).current_dir(project.path()).output();
        done(&cmake.expect("cmake"))
    };
    run(&["-B", "build", &format!("-DCMAKE_PREFIX_PATH={}", prefix.display())]);
    run(&["--build", "build"]);
    for program in ["found", "static"] {
        let output = done(&Command::new(project.path().join("build").join(program)).output().expect("the program"));
        assert!(output.contains("V in the middle 1.00"), "{output}");
    }
}
