//! Writes the tables of shaders, of their stages and of their constants, from `glsl/`.
//!
//! With the feature `compile-shaders` it compiles SPIR-V from `glsl/`. Without, it takes the SPIR-V that `tools/spirv`
//! compiled into `glsl/spirv`, so that the build needs only Rust.

#[cfg(feature = "compile-shaders")]
#[path = "build/compile.rs"]
mod compile;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-changed=glsl");
    // These lines fail the build. With an exit status, cargo would print them a second time.
    if let Err(message) = build() {
        message.lines().for_each(|line| println!("cargo::error={line}"));
    }
}

fn build() -> Result<(), String> {
    let (out, glsl) = (folder("OUT_DIR")?, folder("CARGO_MANIFEST_DIR")?.join("glsl"));
    let shaders = files(&spirv(&out)?, "spv")?;
    let mut table: String = shaders.iter().map(|path| shader_constant(path)).collect();
    let mut constants = BTreeMap::<String, String>::new();
    for path in [files(&glsl, "comp")?, files(&glsl.join("include"), "glsl")?].concat() {
        let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        *constants.entry(stem(&path)).or_default() += &literals(&text);
    }
    for (name, constants) in constants.into_iter().filter(|(_, constants)| !constants.is_empty()) {
        table += &format!("/// Constants of `{name}` in `glsl/`.\npub(crate) mod {name} {{\n{constants}}}\n");
    }
    write(&out.join("shaders.rs"), table.as_bytes())?;
    let stages: String = shaders.iter().map(|path| format!("&{}::STAGE, ", stem(path))).collect();
    write(&out.join("stages.rs"), format!("const STAGES: &[&Stage] = &[{stages}];\n").as_bytes())
}

/// The folder with a file of SPIR-V for each shader.
#[cfg(feature = "compile-shaders")]
fn spirv(out: &Path) -> Result<PathBuf, String> {
    // tools/spirv compiles into another folder.
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

/// The constant of a shader, named after its file.
fn shader_constant(path: &Path) -> String {
    let name = stem(path);
    format!(
        "/// `glsl/{name}.comp`.\npub const {}: Shader = Shader {{ name: {name:?}, spirv: include_bytes!({path:?}) }};\n",
        name.to_uppercase()
    )
}

/// The global constants of a shader that are literal numbers, as Rust constants: `const float A = 0.5, B = 2.0;`.
fn literals(text: &str) -> String {
    let mut constants = String::new();
    for line in text.lines() {
        let Some((kind, rest)) = line.strip_prefix("const ").and_then(|rest| rest.split_once(' ')) else { continue };
        let kind = match kind {
            "int" => "u32",
            "float" => "f64",
            _ => continue,
        };
        let declared = rest.split(';').next().unwrap_or_default().split(',').filter_map(|part| part.split_once(" = "));
        for (name, value) in declared.filter(|(_, value)| value.parse::<f64>().is_ok()) {
            constants += &format!("    pub(crate) const {}: {kind} = {value};\n", name.trim());
        }
    }
    constants
}

fn folder(variable: &str) -> Result<PathBuf, String> {
    env::var_os(variable).map(PathBuf::from).ok_or_else(|| format!("{variable} is not set: build with cargo"))
}

/// The files of a folder with an extension, sorted.
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
