//! The shaders of `glsl/`, in a table that `build.rs` writes: a constant for each, named after its file.

/// A compute shader.
#[derive(Debug)]
pub struct Shader {
    /// Its file in `glsl/`, without `.comp`.
    pub name: &'static str,
    /// SPIR-V 1.6 for Vulkan 1.3, entry point `main`, little endian.
    pub spirv: &'static [u8],
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
