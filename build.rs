//! Compiles `glsl/*.comp` to SPIR-V and writes the table of shaders that `src/shaders.rs` includes.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::{env, fs};

use shaderc::{CompileOptions, Compiler, EnvVersion, ResolvedInclude, SpirvVersion, TargetEnv};

const SHADERS: &str = "glsl";
const INCLUDES: &str = "glsl/include";

/// The text of every include, by its name.
type Includes = BTreeMap<String, String>;

fn main() {
    println!("cargo::rerun-if-changed={SHADERS}");
    // These lines fail the build; an exit status besides would have cargo print them a second time.
    if let Err(message) = build() {
        message.lines().for_each(|line| println!("cargo::error={line}"));
    }
}

fn build() -> Result<(), String> {
    let out = PathBuf::from(env::var("OUT_DIR").map_err(|_| "OUT_DIR is not set: build with cargo".to_string())?);
    let compiler = Compiler::new().map_err(|e| format!("shaderc does not start ({e}): run tools/setup"))?;
    let (mut table, mut all) = (String::new(), String::new());
    // A set: a mistake in an include is one mistake, whichever shaders include it.
    let mut errors = BTreeSet::new();
    for name in shader_names()? {
        match shader(&compiler, &out, &name) {
            Ok(constant) => {
                table += &constant;
                all += &format!("{}, ", name.to_uppercase());
            }
            Err(message) => errors.extend(message.lines().filter(|line| !line.is_empty()).map(str::to_string)),
        }
    }
    if !errors.is_empty() {
        return Err(errors.into_iter().collect::<Vec<_>>().join("\n"));
    }
    table += &format!(
        "/// Every shader, by name.\n#[cfg(test)]\npub const ALL: &[Shader] = &[{}];\n",
        all.trim_end_matches(", ")
    );
    write(&out.join("shaders.rs"), &table)
}

/// The names of the shaders, sorted; each is to become a constant.
fn shader_names() -> Result<Vec<String>, String> {
    let mut names = Vec::new();
    for path in files(SHADERS)?.iter().filter(|path| path.extension().is_some_and(|e| e == "comp")) {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if !name.starts_with(|c: char| c.is_ascii_lowercase()) || !name.chars().all(valid) {
            return Err(format!("{}: a shader is named in a-z, 0-9 and _, from a letter on", path.display()));
        }
        names.push(name);
    }
    names.sort();
    Ok(names)
}

/// The constant of one shader: the one kept from an earlier build if nothing that goes into it has changed.
fn shader(compiler: &Compiler, out: &Path, name: &str) -> Result<String, String> {
    let path = format!("{SHADERS}/{name}.comp");
    let source = read(Path::new(&path))?;
    let mut includes = Includes::new();
    find_includes(&source, &mut includes);

    let kept = out.join(format!("{name}.rs"));
    let key = key(&source, &includes);
    if let Ok(constant) = fs::read_to_string(&kept)
        && constant.starts_with(&key)
    {
        return Ok(constant);
    }
    let spirv = compile(compiler, &path, &source, &includes)?;
    let constant = format!("{key}{}", constant(name, &spirv));
    write(&kept, &constant)?;
    Ok(constant)
}

/// Gathers what `source` includes, and what that includes. One that cannot be read is left for the compiler to report,
/// which knows the line.
fn find_includes(source: &str, includes: &mut Includes) {
    for line in source.lines() {
        let Some(name) = line.trim_start().strip_prefix("#include").and_then(|rest| rest.split('"').nth(1)) else {
            continue;
        };
        if !includes.contains_key(name)
            && let Ok(text) = read(&Path::new(INCLUDES).join(name))
        {
            includes.insert(name.to_string(), text.clone());
            find_includes(&text, includes);
        }
    }
}

/// A first line that differs when the shader, an include, the profile or an option, which stand in this file, differs.
fn key(source: &str, includes: &Includes) -> String {
    let mut hasher = DefaultHasher::new();
    (source, includes, is_debug_build(), include_str!("build.rs")).hash(&mut hasher);
    format!("// {:016x}\n", hasher.finish())
}

fn compile(compiler: &Compiler, path: &str, source: &str, includes: &Includes) -> Result<Vec<u32>, String> {
    let mut options = CompileOptions::new().map_err(|e| format!("shaderc does not start ({e}): run tools/setup"))?;
    options.set_target_env(TargetEnv::Vulkan, EnvVersion::Vulkan1_3 as u32);
    options.set_target_spirv(SpirvVersion::V1_6);
    options.set_warnings_as_errors();
    // In every build, so that the tests run what is shipped.
    options.set_optimization_level(shaderc::OptimizationLevel::Performance);
    if is_debug_build() {
        options.set_generate_debug_info();
    }
    options.set_include_callback(|name, _, _, _| {
        let resolved_name = format!("{INCLUDES}/{name}");
        match includes.get(name) {
            Some(text) => Ok(ResolvedInclude { resolved_name, content: text.clone() }),
            None => Err(format!("there is no {resolved_name}")),
        }
    });
    match compiler.compile_into_spirv(source, shaderc::ShaderKind::Compute, path, "main", Some(&options)) {
        Ok(artifact) => Ok(artifact.as_binary().to_vec()),
        Err(shaderc::Error::CompilationError(_, messages)) => Err(messages),
        Err(other) => Err(format!("{path}: {other}")),
    }
}

/// The words as a literal, which aligns them as Vulkan wants them.
fn constant(name: &str, spirv: &[u32]) -> String {
    let mut text = format!(
        "/// `{SHADERS}/{name}.comp`.\npub const {}: Shader = Shader {{ name: \"{name}\", spirv: &[",
        name.to_uppercase()
    );
    for word in spirv {
        let _ = write!(text, "{word},");
    }
    text + "] };\n"
}

fn is_debug_build() -> bool {
    env::var("PROFILE").is_ok_and(|profile| profile == "debug")
}

/// The files in a folder; none where there is no such folder.
fn files(folder: &str) -> Result<Vec<PathBuf>, String> {
    if !Path::new(folder).exists() {
        return Ok(Vec::new());
    }
    fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| entry.map(|e| e.path())).collect())
        .map_err(|e| format!("{folder}: {e}"))
}

fn read(path: &Path) -> Result<String, String> {
    fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()))
}
