//! Whether `include/parfocal.h` is what cbindgen makes of the sources; `PARFOCAL_HEADER=write cargo test --package parfocal-c
//! --test header` makes it so.

use std::fs;
use std::path::Path;

#[test]
fn the_header_is_of_these_sources() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = here.join("include/parfocal.h");
    let config = cbindgen::Config::from_file(here.join("cbindgen.toml")).expect("cbindgen.toml");
    let sources = [
        "fault", "image", "engine", "vulkan", "settings", "cancel", "solver", "solution", "stream", "sweep", "measure",
    ];
    let builder = sources.iter().fold(cbindgen::Builder::new().with_config(config), |builder, name| {
        builder.with_src(here.join(format!("src/{name}.rs")))
    });
    let mut made = Vec::new();
    builder.generate().expect("the sources are read").write(&mut made);
    let made = String::from_utf8(made).expect("UTF-8");
    if std::env::var_os("PARFOCAL_HEADER").is_some_and(|value| value == "write") {
        fs::write(&file, &made).expect("the header is written");
    }
    assert!(fs::read_to_string(&file).is_ok_and(|kept| kept == made), "PARFOCAL_HEADER=write makes it anew");
}
