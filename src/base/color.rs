//! What stored values mean: the sRGB curve both ways, and luminance.

/// How stored values become intensities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Decode {
    /// As stored.
    #[default]
    None,
    /// The sRGB curve is undone first, so that blur is linear in intensity.
    Srgb,
}

/// Weights of red, green and blue in luminance (Rec. 601).
pub const LUMINANCE: [f32; 3] = [0.299, 0.587, 0.114];

/// Undoes the sRGB curve (IEC 61966-2-1).
pub fn srgb_to_linear(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// The value that a file stores for an intensity, in [0, 1].
pub(crate) fn stored(intensity: f32, decode: Decode) -> f32 {
    let intensity = intensity.clamp(0.0, 1.0);
    match decode {
        Decode::None => intensity,
        Decode::Srgb => linear_to_srgb(intensity),
    }
}

/// The sRGB curve (IEC 61966-2-1).
pub(crate) fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_middle_grey_is_a_fifth_of_the_light() {
        assert!((srgb_to_linear(0.5) - 0.2140).abs() < 1e-4);
        assert_eq!(srgb_to_linear(1.0), 1.0);
    }

    #[test]
    fn values_are_clamped_and_srgb_is_encoded_back() {
        assert_eq!(stored(-1.0, Decode::None), 0.0);
        assert!((stored(2.0, Decode::Srgb) - 1.0).abs() < 1e-6);
        assert_eq!(stored(0.25, Decode::None), 0.25);
        // 50 % stored is 21.4 % linear.
        assert!((stored(0.214_041_1, Decode::Srgb) - 0.5).abs() < 1e-5);
        assert!((stored(0.001, Decode::Srgb) - 0.01292).abs() < 1e-7);
    }
}
