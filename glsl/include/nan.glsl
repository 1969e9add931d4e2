// Declares that NaN and infinities keep their meaning: without it a compiler may take them for impossible. Included by
// the shaders that store NaN where there is no result, and by those that read it.

#extension GL_EXT_spirv_intrinsics : require

// SPIR-V's SignedZeroInfNanPreserve, capability and mode, of 32 bits.
spirv_execution_mode(capabilities = [4466], 4461, 32);
