//! From nearness to colour.

use serde::Serialize;

/// The colours of what is near and far, in every picture and on the page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Palette {
    /// Viridis (van der Walt and Smith 2015): bright yellow near, dark purple far; even steps for the eye, colour-blind or
    /// not, and in grey print.
    #[default]
    Viridis,
    /// Red near, blue far, as in the paper: Turbo (Mikhailov 2019), with even steps in between.
    RedBlue,
    /// White near, black far.
    Grey,
}

impl Palette {
    /// RGB of a nearness, 0 far to 1 near; what lies beyond has the colour of the end.
    pub fn color(self, nearness: f64) -> [u8; 3] {
        let t = nearness.clamp(0.0, 1.0);
        match self {
            Self::Viridis => colorous::VIRIDIS.eval_continuous(t).as_array(),
            // Its last tenth at either end darkens towards violet and maroon; left out, near is plainly red and far blue.
            Self::RedBlue => colorous::TURBO.eval_continuous(0.1 + 0.8 * t).as_array(),
            Self::Grey => [(255.0 * t).round() as u8; 3],
        }
    }

    /// The names of the colours of near and far.
    pub fn ends(self) -> [&'static str; 2] {
        match self {
            Self::Viridis => ["yellow", "purple"],
            Self::RedBlue => ["red", "blue"],
            Self::Grey => ["white", "black"],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_is_bright_yellow_red_or_white() {
        let [near, far] = [1.0, 0.0].map(|t| Palette::Viridis.color(t));
        assert!(near[0] > 200 && near[1] > 200 && near[2] < 80, "{near:?}");
        assert!(far.iter().all(|c| *c < 100) && far[2] > far[1], "{far:?}");
        assert_eq!((Palette::Grey.color(2.0), Palette::Grey.color(-1.0)), ([255; 3], [0; 3]));
        let [[r, g, b], far] = [1.0, 0.0].map(|t| Palette::RedBlue.color(t));
        assert!(r > 150 && g < 100 && b < 50, "{r} {g} {b}");
        assert!(far[2] > 200 && far[0] < 100 && far[1] < 150, "{far:?}");
    }

    #[test]
    fn viridis_brightens_all_the_way() {
        let luminance = |t: f64| {
            let [r, g, b] = Palette::Viridis.color(t).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps: Vec<f64> = (0..=50).map(|i| luminance(f64::from(i) / 50.0)).collect();
        assert!(steps.is_sorted(), "{steps:?}");
    }
}
