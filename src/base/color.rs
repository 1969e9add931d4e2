//! What stored values mean: the sRGB curve both ways, and luminance.

use crate::base::Depth;

choices! {
    /// How stored values become intensities.
    pub enum Decode {
        /// As the files state; else linear, but 8 bits sRGB unless the program finds them linear by their noise
        #[default]
        Auto = "auto",
        /// As stored
        None = "none",
        /// By the inverse of the sRGB curve, so that blur is linear in the intensities
        Srgb = "srgb",
    }
}

impl Decode {
    /// Replaces [`Decode::Auto`] by what the samples of all photographs of one scene imply.
    ///
    /// 8 bits are made to be looked at and follow the sRGB curve, as browsers assume too: so few bits of linear light
    /// would show steps in the dark. More bits are a measurement, and linear. If any photograph has 8 bits, all are
    /// sRGB.
    pub fn resolved(self, depths: impl IntoIterator<Item = Depth>) -> Self {
        match self {
            Self::Auto if depths.into_iter().any(|depth| depth == Depth::U8) => Self::Srgb,
            Self::Auto => Self::None,
            stated => stated,
        }
    }

    /// The intensity of a stored value.
    pub(crate) fn intensity(self, stored: f64) -> f64 {
        if self == Self::Srgb { srgb_to_linear(stored) } else { stored }
    }
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
    if decode == Decode::Srgb { linear_to_srgb(intensity) } else { intensity }
}

/// The sRGB curve (IEC 61966-2-1).
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn auto_is_srgb_for_8_bits_and_linear_for_more() {
        assert_eq!(Decode::default(), Decode::Auto);
        assert_eq!(Decode::Auto.resolved([Depth::U8, Depth::U16]), Decode::Srgb);
        assert_eq!(Decode::Auto.resolved([Depth::U16, Depth::F32]), Decode::None);
        assert_eq!(Decode::None.resolved([Depth::U8]), Decode::None);
        assert_eq!(Decode::Srgb.resolved([Depth::F32]), Decode::Srgb);
    }

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
