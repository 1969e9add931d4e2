//! Writes the Rust interfaces of the shaders from `glsl/`: constants, push constants, bindings, flags and structs.
//!
//! The text of a shader is the one declaration of its interface. The build fails if it differs from the SPIR-V.
//!
//! With the feature `compile-shaders` it compiles SPIR-V from `glsl/`. Without, it takes the SPIR-V that `tools/spirv`
//! compiled into `glsl/spirv`, so that the build needs only Rust.

#[cfg(feature = "compile-shaders")]
#[path = "build/compile.rs"]
mod compile;
#[path = "build/glsl.rs"]
mod glsl;
#[path = "build/interface.rs"]
mod interface;
#[path = "build/spirv.rs"]
mod spirv;

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
    let spirv = spirv(&out)?;
    let (mut modules, mut shaders) = (BTreeMap::<String, String>::new(), BTreeMap::new());
    let (mut table, mut stages) = (String::new(), String::new());
    for path in files(&glsl, "comp")? {
        let name = stem(&path);
        let shader = glsl::Shader::read(&format!("{name}.comp"), &|path| text(&glsl.join(path)))?;
        let compiled = spirv.join(&name).with_extension("spv");
        let bytes = fs::read(&compiled).map_err(|e| format!("{}: {e}: run tools/spirv", compiled.display()))?;
        spirv::verify(&shader, &bytes)
            .map_err(|e| format!("glsl/{name}.comp: {e} in {}: run tools/spirv", compiled.display()))?;
        table += &shader_constant(&compiled);
        modules.insert(name.clone(), literals(&path)? + &interface::of_constants(&shader));
        stages += &interface::of_stage(&name, &shader)?;
        shaders.insert(name, shader);
    }
    for path in files(&glsl.join("include"), "glsl")? {
        let text = literals(&path)? + &interface::of_structs(&stem(&path), shaders.values());
        *modules.entry(stem(&path)).or_default() += &text;
    }
    for (name, text) in modules.into_iter().filter(|(_, text)| !text.is_empty()) {
        table += &format!("/// Constants and structs of `{name}` in `glsl/`.\npub mod {name} {{\n{text}}}\n");
    }
    let (flags, state) = (interface::of_flags(&shaders)?, interface::of_double(shaders.values())?);
    let texts = [("shaders.rs", table), ("stages.rs", stages), ("flags.rs", flags), ("state.rs", state)];
    texts.into_iter().try_for_each(|(file, text)| write(&out.join(file), text.as_bytes()))
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

/// The global constants of a file that are literal numbers, as Rust constants: `const float A = 0.5, B = 2.0;`.
fn literals(path: &Path) -> Result<String, String> {
    let mut constants = String::new();
    for line in text(path)?.lines() {
        let Some((kind, rest)) = line.strip_prefix("const ").and_then(|rest| rest.split_once(' ')) else { continue };
        let kind = match kind {
            "int" => "u32",
            "float" => "f64",
            _ => continue,
        };
        for (name, value) in glsl::literals(rest).filter(|(_, value)| value.parse::<f64>().is_ok()) {
            constants += &format!("pub(crate) const {name}: {kind} = {value};\n");
        }
    }
    Ok(constants)
}

fn text(path: &Path) -> Result<String, String> {
    fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
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
