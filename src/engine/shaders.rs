//! The shaders of `glsl/`, compiled by `build.rs`: a constant for each, named after its file, and `ALL` of them.

/// A compute shader.
#[derive(Debug)]
pub struct Shader {
    /// Its file in `glsl/`, without `.comp`.
    pub name: &'static str,
    /// SPIR-V 1.6 for Vulkan 1.3, entry point `main`.
    pub spirv: &'static [u32],
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shader_is_spirv_and_in_order() {
        assert!(ALL.iter().all(|shader| shader.spirv.first() == Some(&0x0723_0203)));
        assert!(ALL.is_sorted_by_key(|shader| shader.name));
    }
}
