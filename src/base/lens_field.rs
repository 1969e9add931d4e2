//! How V changes over the field of a lens.

use crate::base::Error;
use crate::base::settings::Settings;
use crate::base::smooth_field::{QUADRATIC, TERMS, sum, terms};

/// The gain and the offset of V at each place of the photographs: V there is `(1 + g) V_c + o`, where the image centre
/// has V_c. The [`Lens`](super::Lens) holds at the centre.
///
/// g and o are polynomials of the place, relative to the image centre, in half diagonals: g of second degree, o of
/// fourth. Both are 0 at the centre. The offset is the curvature of the field. The gain is due to an aperture that
/// seems to be narrower or wider from another place.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct LensField {
    /// Width and height of the photographs, px.
    pub size: [u32; 2],
    /// Coefficients of g: of x, y, x², xy, y².
    pub gain: [f64; QUADRATIC - 1],
    /// Coefficients of o, px²: of x, y, x², xy, y², x³, and so on to y⁴.
    #[cfg_attr(feature = "serde", serde(rename = "offset_px2"))]
    pub offset: [f64; TERMS - 1],
}

impl LensField {
    /// The least value of 1 + g. With less, V at a place hardly depends on depth.
    const LEAST_GAIN: f64 = 0.1;
    /// The greatest |o|, px²: that of the greatest limit of |V|.
    const GREATEST_OFFSET: f64 = Settings::WIDEST_BLUR;
    /// Places along a side at which a field is inspected.
    const PLACES: usize = 17;

    /// Checks the size and the coefficients.
    ///
    /// # Errors
    /// [`Error::Setting`] for a side of 0 px, an offset beyond ±1024 px² in the frame, or a gain `1 + g` below 0.1 or
    /// above 10 in the frame.
    pub fn check(&self) -> Result<(), Error> {
        if self.size.contains(&0) {
            let range = "at least 1 px".to_string();
            return Err(Error::Setting { name: "side of the field of the lens", value: 0.0, range });
        }
        let [least, most] = self.gains();
        let gain = if least >= Self::LEAST_GAIN { most } else { least };
        if !(Self::LEAST_GAIN..=1.0 / Self::LEAST_GAIN).contains(&gain) {
            let range = "from 0.1 to 10 all over the frame".to_string();
            return Err(Error::Setting { name: "gain of V over the field", value: gain, range });
        }
        let [least, most] = self.offsets();
        let offset = if least >= -Self::GREATEST_OFFSET { most } else { least };
        if !(-Self::GREATEST_OFFSET..=Self::GREATEST_OFFSET).contains(&offset) {
            let range = format!("from -{0} to {0} px² all over the frame", Self::GREATEST_OFFSET);
            return Err(Error::Setting { name: "offset of V over the field", value: offset, range });
        }
        Ok(())
    }

    /// Returns `1 + g`, and o in px², at a place in the photographs, px.
    pub fn at(&self, place: [f64; 2]) -> [f64; 2] {
        let terms = &terms(self.size, place)[1..];
        [1.0 + sum(terms, &self.gain), sum(terms, &self.offset)]
    }

    /// Returns the least and the greatest `1 + g` in the frame. NaN if it is not finite somewhere.
    pub fn gains(&self) -> [f64; 2] {
        self.range(0)
    }

    /// Returns the least and the greatest o in the frame, px².
    pub fn offsets(&self) -> [f64; 2] {
        self.range(1)
    }

    fn range(&self, of: usize) -> [f64; 2] {
        Self::places(self.size).map(|place| self.at(place)[of]).fold(
            [f64::INFINITY, f64::NEG_INFINITY],
            |range, value| {
                if value.is_finite() { [range[0].min(value), range[1].max(value)] } else { [f64::NAN; 2] }
            },
        )
    }

    /// Returns places that are spread evenly over photographs, with their borders.
    pub(crate) fn places(size: [u32; 2]) -> impl Iterator<Item = [f64; 2]> {
        let last = (Self::PLACES - 1) as f64;
        let at = move |n: usize, side: u32| n as f64 / last * (f64::from(side) - 1.0);
        (0..Self::PLACES.pow(2)).map(move |n| [at(n % Self::PLACES, size[0]), at(n / Self::PLACES, size[1])])
    }

    /// Returns V_c and its standard deviation from V and its standard deviation, px². Both are row-major with `width`
    /// values a row; `origin` is the place of the first in the photographs. A pixel at the `limit` of |V| stays there,
    /// and no other pixel reaches it, because the limit marks V as a bound only.
    pub fn to_centre(&self, [blur, deviation]: [&[f32]; 2], width: u32, origin: [u32; 2], limit: f64) -> [Vec<f32>; 2] {
        let (reached, below, width) = (0.999 * limit, 0.998 * limit, width.max(1) as usize);
        let pixel = |(i, (&v, &sigma)): (usize, (&f32, &f32))| {
            let place = [origin[0] as usize + i % width, origin[1] as usize + i / width].map(|at| at as f64);
            let ([gain, offset], whole) = (self.at(place), f64::from(v));
            // Nothing is below a limit that is NaN.
            match whole.abs() < reached {
                true => (((whole - offset) / gain).clamp(-below, below) as f32, (f64::from(sigma) / gain) as f32),
                false => (v, sigma),
            }
        };
        let (blur, deviation) = blur.iter().zip(deviation).enumerate().map(pixel).unzip();
        [blur, deviation]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field() -> LensField {
        let mut offset = [0.0; TERMS - 1];
        offset[2] = 3.0;
        LensField { size: [301, 201], gain: [0.2, 0.0, 0.0, 0.0, -0.1], offset }
    }

    #[test]
    fn gain_and_offset_are_undone_but_not_at_the_limit() {
        let (field, half) = (field(), 150f64.hypot(100.0));
        assert!((field.at([150.0, 100.0]) == [1.0, 0.0]) && field.check().is_ok());
        let [gain, offset] = field.at([250.0, 150.0]);
        let (x, y) = (100.0 / half, 50.0 / half);
        assert!((gain - (1.0 + 0.2 * x - 0.1 * y * y)).abs() < 2e-3 && (offset - 3.0 * x * x).abs() < 2e-2);
        let v = [(gain * 4.0 + offset) as f32, f32::NAN, 144.0, -144.0];
        let [found, deviation] = field.to_centre([&v, &[0.2; 4]], 1, [250, 150], 144.0);
        assert!((found[0] - 4.0).abs() < 1e-5 && (f64::from(deviation[0]) - 0.2 / gain).abs() < 1e-7);
        assert!(found[1].is_nan() && found[2..] == [144.0, -144.0] && deviation[1..] == [0.2; 3]);
        let [beyond, _] = field.to_centre([&[143.0], &[0.2]], 1, [0, 0], 144.0);
        assert!(beyond[0] < 0.999 * 144.0, "a pixel must not reach the limit");
        assert_eq!(field.to_centre([&[1.0], &[0.2]], 1, [0, 0], f64::NAN), [vec![1.0], vec![0.2]]);
    }

    #[test]
    fn an_impossible_field_is_refused() {
        for gain in [-3.0, 30.0, f64::NAN] {
            assert!(LensField { gain: [gain, 0.0, 0.0, 0.0, 0.0], ..field() }.check().is_err(), "{gain}");
        }
        for offset in [f64::INFINITY, f64::NAN, 1e308, -1e4] {
            let mut impossible = field();
            impossible.offset[3] = offset;
            assert!(impossible.check().is_err(), "{offset}");
        }
        assert!(LensField { size: [0, 0], ..field() }.check().is_err());
    }
}
