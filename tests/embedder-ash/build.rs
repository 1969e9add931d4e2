//! `glsl/` to SPIR-V.

use std::path::Path;
use std::{env, fs};

use shaderc::{Compiler, ShaderKind};

fn main() {
    println!("cargo::rerun-if-changed=glsl");
    let out = env::var("OUT_DIR").expect("cargo says where");
    let compiler = Compiler::new().expect("shaderc starts");
    for (name, kind) in [("screen.vert", ShaderKind::Vertex), ("blur.frag", ShaderKind::Fragment)] {
        let source = fs::read_to_string(Path::new("glsl").join(name)).expect("a shader");
        let spirv = compiler.compile_into_spirv(&source, kind, name, "main", None).expect("a shader that compiles");
        fs::write(Path::new(&out).join(format!("{name}.spv")), spirv.as_binary_u8()).expect("a place for SPIR-V");
    }
}
