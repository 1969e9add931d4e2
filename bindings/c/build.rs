//! The shared library is told its name in the prefix: libparfocal.so.0, the number being that of its binary interface.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libparfocal.so.0");
    }
}
