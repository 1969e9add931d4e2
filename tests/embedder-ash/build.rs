//! Compiles `glsl/` to SPIR-V.

use std::path::Path;
use std::{env, fs};

use shaderc::{Compiler, ShaderKind};

fn main() {
    println!("cargo::rerun-if-changed=glsl");
    let out = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let compiler = Compiler::new().expect("shaderc starts");
    for (name, kind) in [("screen.vert", ShaderKind::Vertex), ("blur.frag", ShaderKind::Fragment)] {
        let source = fs::read_to_string(Path::new("glsl").join(name)).expect("the shader is read");
        let spirv = compiler.compile_into_spirv(&source, kind, name, "main", None).expect("the shader compiles");
        fs::write(Path::new(&out).join(format!("{name}.spv")), spirv.as_binary_u8()).expect("OUT_DIR is writable");
    }
}
