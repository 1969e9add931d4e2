//! Writes the table of shaders that `src/engine/shaders.rs` includes.
//!
//! With the feature `compile-shaders` their SPIR-V is compiled from `glsl/`. Without, it is what `tools/spirv` compiled
//! into `glsl/spirv`: the build then needs nothing but Rust.

#[cfg(feature = "compile-shaders")]
#[path = "build/compile.rs"]
mod compile;

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-changed=glsl");
    // These lines fail the build; an exit status besides would have cargo print them a second time.
    if let Err(message) = build() {
        message.lines().for_each(|line| println!("cargo::error={line}"));
    }
}

fn build() -> Result<(), String> {
    let out = folder("OUT_DIR")?;
    let table: String = files(&spirv(&out)?, "spv")?.iter().map(|path| constant(path)).collect();
    write(&out.join("shaders.rs"), table.as_bytes())
}

/// The folder with a file of SPIR-V for each shader.
#[cfg(feature = "compile-shaders")]
fn spirv(out: &Path) -> Result<PathBuf, String> {
    // tools/spirv wants them elsewhere.
    println!("cargo::rerun-if-env-changed=PARFOCAL_SPIRV");
    let folder = env::var_os("PARFOCAL_SPIRV").map_or_else(|| out.join("spirv"), PathBuf::from);
    compile::all(&folder)?;
    Ok(folder)
}

/// The folder with a file of SPIR-V for each shader.
#[cfg(not(feature = "compile-shaders"))]
fn spirv(_: &Path) -> Result<PathBuf, String> {
    Ok(folder("CARGO_MANIFEST_DIR")?.join("glsl/spirv"))
}

/// The constant of one shader, named after its file.
fn constant(path: &Path) -> String {
    let name = stem(path);
    format!(
        "/// `glsl/{name}.comp`.\npub const {}: Shader = Shader {{ name: {name:?}, spirv: include_bytes!({path:?}) }};\n",
        name.to_uppercase()
    )
}

fn folder(variable: &str) -> Result<PathBuf, String> {
    env::var_os(variable).map(PathBuf::from).ok_or_else(|| format!("{variable} is not set: build with cargo"))
}

/// The files in a folder that end so, sorted.
fn files(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, String> {
    let mut paths = fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| entry.map(|e| e.path())).collect::<Result<Vec<_>, _>>())
        .map_err(|e| format!("{}: {e}", folder.display()))?;
    paths.retain(|path| path.extension().is_some_and(|e| e == extension));
    paths.sort();
    Ok(paths)
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), String> {
    fs::write(path, bytes).map_err(|e| format!("{}: {e}", path.display()))
}
