//! Compiles `glsl/*.comp` to SPIR-V, with warnings as errors.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use shaderc::{CompileOptions, Compiler, EnvVersion, ResolvedInclude, SpirvVersion, TargetEnv};

use super::{files, stem, write};

const SHADERS: &str = "glsl";
const INCLUDES: &str = "glsl/include";

/// Compiles each shader to a file of its name in a folder, which is emptied first.
pub(super) fn all(folder: &Path) -> Result<(), String> {
    let compiler = Compiler::new().map_err(no_start)?;
    let options = options()?;
    let _ = fs::remove_dir_all(folder);
    fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    // A set, so that an error in an include is reported once.
    let mut errors = BTreeSet::new();
    for path in files(Path::new(SHADERS), "comp")? {
        match shader(&compiler, &options, &path) {
            Ok(spirv) => write(&folder.join(stem(&path)).with_extension("spv"), &spirv)?,
            Err(message) => errors.extend(message.lines().filter(|line| !line.is_empty()).map(str::to_string)),
        }
    }
    if errors.is_empty() { Ok(()) } else { Err(errors.into_iter().collect::<Vec<_>>().join("\n")) }
}

/// The options of all builds, so that tests run the shipped SPIR-V.
fn options() -> Result<CompileOptions<'static>, String> {
    let mut options = CompileOptions::new().map_err(no_start)?;
    options.set_target_env(TargetEnv::Vulkan, EnvVersion::Vulkan1_3 as u32);
    options.set_target_spirv(SpirvVersion::V1_6);
    options.set_warnings_as_errors();
    options.set_optimization_level(shaderc::OptimizationLevel::Performance);
    options.set_include_callback(|name, _, _, _| {
        let resolved_name = format!("{INCLUDES}/{name}");
        let content = fs::read_to_string(&resolved_name).map_err(|e| format!("{resolved_name}: {e}"))?;
        Ok(ResolvedInclude { resolved_name, content })
    });
    Ok(options)
}

/// Compiles one shader. A constant is named after it.
fn shader(compiler: &Compiler, options: &CompileOptions, path: &Path) -> Result<Vec<u8>, String> {
    let (name, path) = (stem(path), path.display().to_string());
    let valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !name.starts_with(|c: char| c.is_ascii_lowercase()) || !name.chars().all(valid) {
        return Err(format!("{path}: rename the shader: use a-z, 0-9 and _, beginning with a letter"));
    }
    let source = fs::read_to_string(&path).map_err(|e| format!("{path}: {e}"))?;
    match compiler.compile_into_spirv(&source, shaderc::ShaderKind::Compute, &path, "main", Some(options)) {
        Ok(artifact) => Ok(artifact.as_binary_u8().to_vec()),
        Err(shaderc::Error::CompilationError(_, messages)) => Err(messages),
        Err(other) => Err(format!("{path}: {other}")),
    }
}

fn no_start(error: shaderc::Error) -> String {
    format!("shaderc does not load ({error}): run tools/setup")
}
