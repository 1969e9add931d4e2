//! The transfer curve of an ICC profile, read from its tables, and frames that store their values by it.

use moxcms::{ColorProfile, DataColorSpace, Layout, ParsingOptions, TransformOptions};

use crate::base::color::{linear_to_srgb, srgb_to_linear};
use crate::base::{Decode, Frame};

/// The values follow the sRGB curve.
pub(super) const SRGB: &str = "sRGB";
/// The values are proportional to light.
pub(super) const LINEAR: &str = "linear";
/// The ICC profile cannot be read.
pub(super) const UNREADABLE: &str = "those of an ICC profile that cannot be read";

/// Greatest number of bytes of an ICC profile that are parsed, 4 MiB. A profile with tables for a printer has 2 MiB.
pub(super) const MAX_PROFILE: usize = 4 << 20;

/// Greatest number of tags of a profile. Real profiles have two dozen, and a hostile one may repeat a large table.
const MAX_TAGS: u32 = 100;

/// Number of stored values at which a curve is known, evenly from 0 to 1.
const NODES: usize = 1025;

/// Greatest difference in light between curves that are decoded alike. That of gamma 2.2 and sRGB is 0.0085.
const ALIKE: f32 = 0.01;

/// Greatest difference in light between a curve and the one that it is called by.
const SAME: f32 = 0.004;

/// A transfer curve as the sRGB value of each stored value. It rises from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve(Vec<f32>);

/// The curve that a profile states: its name, and its table if it is neither linear nor nearly sRGB. `None` if it cannot
/// be read.
pub(super) fn curve_of(profile: &[u8]) -> Option<(String, Option<Curve>)> {
    let light = light_of(&parsed(profile)?)?;
    let differs = |curve: &dyn Fn(f32) -> f32| {
        let nodes = light.iter().enumerate().map(|(n, light)| (curve(node(n)) - light).abs());
        nodes.fold(0.0, f32::max)
    };
    let (linear, srgb) = (differs(&|x| x), differs(&|x| srgb_to_linear(x.into()) as f32));
    if linear < ALIKE {
        return Some((LINEAR.to_string(), None));
    }
    let gamma = light[NODES / 2].ln() / 0.5f32.ln();
    let name = if srgb < SAME {
        SRGB.to_string()
    } else if differs(&|x| x.powf(gamma)) < SAME {
        format!("gamma {gamma:.2}")
    } else {
        "an ICC curve".to_string()
    };
    let curve = (srgb >= ALIKE).then(|| Curve(light.iter().map(|light| linear_to_srgb(*light)).collect()));
    Some((name, curve))
}

fn node(n: usize) -> f32 {
    n as f32 / (NODES - 1) as f32
}

fn parsed(profile: &[u8]) -> Option<ColorProfile> {
    let tags = u32::from_be_bytes(profile.get(128..132)?.try_into().ok()?);
    let options = ParsingOptions { max_profile_size: MAX_PROFILE, ..ParsingOptions::default() };
    (tags <= MAX_TAGS).then(|| ColorProfile::new_from_slice_with_options(profile, options).ok()).flatten()
}

/// The light of each stored value, from 0 to 1: of grey, or of the neutral axis.
fn light_of(profile: &ColorProfile) -> Option<Vec<f32>> {
    let light: Vec<f32> = match profile.gray_trc.as_ref().or(profile.green_trc.as_ref()) {
        Some(curve) => {
            let curve = curve.make_linear_evaluator().ok()?;
            // The crate's power of 0 is no number of use.
            (0..NODES).map(|n| curve.evaluate_value(node(n).max(1e-5))).collect()
        }
        // A profile of tables alone.
        None => {
            let (layout, count) =
                if profile.color_space == DataColorSpace::Gray { (Layout::Gray, 1) } else { (Layout::Rgb, 3) };
            let options = TransformOptions::default();
            let srgb = ColorProfile::new_srgb();
            let transform = profile.create_transform_f32(layout, &srgb, Layout::Rgb, options).ok()?;
            let stored: Vec<f32> = (0..NODES).flat_map(|n| std::iter::repeat_n(node(n), count)).collect();
            let mut shown = vec![0.0; 3 * NODES];
            transform.transform(&stored, &mut shown).ok()?;
            shown.chunks_exact(3).map(|rgb| srgb_to_linear(rgb[1].into()) as f32).collect()
        }
    };
    let (first, last) = (light[0], light[NODES - 1]);
    let mut most = 0.0;
    let rising = light.iter().map(|light| {
        most = ((light - first) / (last - first)).clamp(most, 1.0);
        most
    });
    // NaN does not rise either.
    (last - first > 0.1).then(|| rising.collect())
}

impl Curve {
    /// The curve `light = stored^gamma`.
    pub(super) fn of_gamma(gamma: f32) -> Self {
        Self((0..NODES).map(|n| linear_to_srgb(node(n).powf(gamma))).collect())
    }

    /// The sRGB value of a stored value.
    fn to_srgb(&self, stored: f32) -> f32 {
        let at = stored.clamp(0.0, 1.0) * (NODES - 1) as f32;
        let n = (at as usize).min(NODES - 2);
        self.0[n] + (at - n as f32) * (self.0[n + 1] - self.0[n])
    }

    /// The stored value of an sRGB value.
    pub(crate) fn stored(&self, srgb: f32) -> f32 {
        let n = self.0.partition_point(|value| *value < srgb).clamp(1, NODES - 1);
        let [below, above] = [self.0[n - 1], self.0[n]];
        let share = if above > below { ((srgb - below) / (above - below)).clamp(0.0, 1.0) } else { 1.0 };
        (n as f32 - 1.0 + share) / (NODES - 1) as f32
    }

    /// A frame whose values are stored by this curve, by that of sRGB instead, in 16 bits or floats.
    pub(super) fn in_srgb(&self, frame: &Frame) -> Frame {
        mapped(&frame.widened(), |v| self.to_srgb(v))
    }

    /// Undoes [`in_srgb`](Self::in_srgb).
    pub(crate) fn encoded(&self, frame: &Frame) -> Frame {
        mapped(frame, |v| self.stored(v))
    }
}

/// A frame with other values from black to white. Floats beyond stay.
fn mapped(frame: &Frame, of: impl Fn(f32) -> f32) -> Frame {
    let values = frame.intensities(Decode::None).into_iter();
    let values: Vec<f32> = values.map(|v| if (0.0..=1.0).contains(&v) { of(v) } else { v }).collect();
    frame.with_intensities(&values)
}

#[cfg(test)]
mod tests {
    use moxcms::{ToneReprCurve, curve_from_gamma};

    use super::*;
    use crate::base::{Channels, Samples};

    /// A profile that is called sRGB and has this curve.
    fn profile(curve: ToneReprCurve) -> Vec<u8> {
        let mut profile = ColorProfile::new_srgb();
        profile.cicp = None;
        (profile.red_trc, profile.green_trc, profile.blue_trc) =
            (Some(curve.clone()), Some(curve.clone()), Some(curve));
        profile.encode().unwrap()
    }

    #[test]
    fn the_curve_counts_and_not_the_name() {
        let table = |of: &dyn Fn(f64) -> f64| {
            ToneReprCurve::Lut((0..1024).map(|i| (65535.0 * of(f64::from(i) / 1023.0)).round() as u16).collect())
        };
        let lightness = |x: f64| if x > 0.08 { ((100.0 * x + 16.0) / 116.0).powi(3) } else { x / 9.033 };
        for (curve, name, is_own) in [
            (ToneReprCurve::Lut(Vec::new()), "linear", false),
            (curve_from_gamma(1.0), "linear", false),
            (ToneReprCurve::Parametric(vec![1.0]), "linear", false),
            (ToneReprCurve::Parametric(vec![2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045]), "sRGB", false),
            (table(&srgb_to_linear), "sRGB", false),
            (curve_from_gamma(2.199_218_8), "gamma 2.20", false),
            (curve_from_gamma(1.8), "gamma 1.80", true),
            (table(&|x| x.powf(2.6)), "gamma 2.60", true),
            (table(&lightness), "an ICC curve", true),
        ] {
            let (found, curve) = curve_of(&profile(curve)).unwrap();
            assert_eq!((found.as_str(), curve.is_some()), (name, is_own));
        }
        let mut gray = ColorProfile::new_gray_with_gamma(1.8);
        gray.color_space = DataColorSpace::Gray;
        assert_eq!(curve_of(&gray.encode().unwrap()).unwrap().0, "gamma 1.80");
    }

    #[test]
    fn values_in_srgb_are_those_of_the_curve_and_return() {
        let curve = Curve::of_gamma(1.8);
        let frame = Frame::new(16, 16, Channels::Gray, Samples::U8((0..=255).collect())).unwrap();
        let srgb = curve.in_srgb(&frame);
        for (n, light) in srgb.intensities(Decode::Srgb).iter().enumerate() {
            let expected = (n as f32 / 255.0).powf(1.8);
            assert!((light - expected).abs() < 1e-4, "{n}: {light} {expected}");
        }
        let [Samples::U16(back), Samples::U16(whole)] =
            [curve.encoded(&srgb), frame.widened()].map(|frame| frame.samples().clone())
        else {
            panic!("16 bits")
        };
        // The sRGB values of the darkest are rounded to 16 bits.
        assert!(back.iter().zip(&whole).all(|(a, b)| a.abs_diff(*b) <= 3));
    }

    #[test]
    fn an_unreadable_profile_has_no_curve() {
        for whole in [ColorProfile::new_srgb().encode().unwrap(), profile(curve_from_gamma(1.8))] {
            for at in (0..whole.len()).step_by(7) {
                let _ = curve_of(&whole[..at]);
                let mut bent = whole.clone();
                bent[at] ^= 0xa5;
                // The reader of a file catches panics.
                let _ = std::panic::catch_unwind(|| curve_of(&bent));
            }
        }
        let large = [profile(curve_from_gamma(1.8)), vec![0; MAX_PROFILE]].concat();
        for bad in [&[0xff; 300][..], &[], &large] {
            assert_eq!(curve_of(bad), None);
        }
    }
}
