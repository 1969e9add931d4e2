//! Tests that `include/parfocal.h` is what cbindgen generates from the sources. This command regenerates it:
//! `PARFOCAL_HEADER=write cargo test --package parfocal-c --test header`.

use std::fs;
use std::path::Path;

#[test]
fn the_header_matches_the_sources() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = here.join("include/parfocal.h");
    let mut config = cbindgen::Config::from_file(here.join("cbindgen.toml")).expect("cbindgen.toml");
    config.after_includes = Some(version_macros());
    let sources = [
        "fault", "image", "engine", "vulkan", "settings", "cancel", "solver", "solution", "stream", "sweep", "measure",
        "texture",
    ];
    let builder = sources.iter().fold(cbindgen::Builder::new().with_config(config), |builder, name| {
        builder.with_src(here.join(format!("src/{name}.rs")))
    });
    let mut generated = Vec::new();
    builder.generate().expect("the sources are read").write(&mut generated);
    let generated = String::from_utf8(generated).expect("UTF-8");
    if std::env::var_os("PARFOCAL_HEADER").is_some_and(|value| value == "write") {
        fs::write(&file, &generated).expect("the header is written");
    }
    let matches = fs::read_to_string(&file).is_ok_and(|header| header == generated);
    assert!(matches, "include/parfocal.h is outdated: set PARFOCAL_HEADER=write to regenerate it");
}

/// The version of the header as macros, for the preprocessor.
fn version_macros() -> String {
    format!(
        "\n// The version of this header. parfocal_version() returns that of the library.\n\
         #define PARFOCAL_VERSION \"{}\"\n\
         #define PARFOCAL_VERSION_MAJOR {}\n\
         #define PARFOCAL_VERSION_MINOR {}\n\
         #define PARFOCAL_VERSION_PATCH {}",
        env!("CARGO_PKG_VERSION"),
        env!("CARGO_PKG_VERSION_MAJOR"),
        env!("CARGO_PKG_VERSION_MINOR"),
        env!("CARGO_PKG_VERSION_PATCH"),
    )
}
