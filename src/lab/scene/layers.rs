//! Flat cards in front of a ground: shapes whose edges hide what lies behind them.

use serde::{Deserialize, Serialize};

use crate::base::random::Random;
use crate::base::{Lens, centre};

/// How cards stand in front of the ground; the seed places them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Arrangement {
    /// One large card, near, over a far ground.
    Card,
    /// Eight plates at as many heights, all turned alike, as of a machined part.
    Blocks,
    /// Thin bars of 4 to 30 px, near, over a far ground.
    Bars,
}

/// A flat thing, square to the axis of the lens.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layer {
    /// Distance from the lens, mm.
    pub(super) depth: f64,
    /// Where it ends; the ground does not.
    pub(super) outline: Option<Rectangle>,
    /// Its mean radiance; its texture is so much more or less.
    pub(super) mean: f64,
    /// Added to a place before its texture is read, px of I1: no two layers show the same.
    pub(super) offset: [f64; 2],
}

/// A rectangle as the middle of the lens sees it, px of I1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    pub(super) centre: [f64; 2],
    /// Half of its sides.
    pub(super) half: [f64; 2],
    /// Cosine and sine of the angle that its first side has to the rows.
    pub(super) direction: [f64; 2],
}

impl Rectangle {
    /// How far inside of its nearest edges a place lies, along both of its sides; negative outside.
    pub(super) fn depth_inside(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let ([x, y], [c, s]) = ([x - self.centre[0], y - self.centre[1]], self.direction);
        [self.half[0] - (c * x + s * y).abs(), self.half[1] - (c * y - s * x).abs()]
    }

    fn contains(&self, place: [f64; 2]) -> bool {
        self.depth_inside(place).iter().all(|d| *d >= 0.0)
    }
}

/// Contrast of every layer's texture.
pub(super) const CONTRAST: f64 = 0.7;

impl Arrangement {
    /// The layers, nearest first; the ground is the last. Depths lie between the focus distances of the lens.
    pub(super) fn layers(self, seed: u64, size: [u32; 2], lens: &Lens) -> Vec<Layer> {
        let mut random = Random::new(seed, 4);
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let (near, far) = (lens.focus[0].min(lens.focus[1]), lens.focus[0].max(lens.focus[1]));
        let ([cx, cy], short) = (centre(size[0], size[1]), f64::from(size[0].min(size[1])));
        let mut rectangle = |reach: f64, half: [f64; 2], degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let middle = [cx, cy].map(|c| c + short * between(-reach, reach));
            Rectangle { centre: middle, half, direction: [cos, sin] }
        };
        // Nearness from 0 at the far focus to 1 at the near one.
        let mut plates: Vec<(f64, Rectangle)> = match self {
            Arrangement::Card => vec![(0.9, rectangle(0.1, [0.28 * short, 0.22 * short], 12.0))],
            Arrangement::Blocks => (0..8)
                .map(|i| (0.2 + 0.1 * f64::from(i), short * (0.26 - 0.02 * f64::from(i))))
                .map(|(nearness, half)| (nearness, rectangle(0.35, [half, 0.6 * half], 8.0)))
                .collect(),
            Arrangement::Bars => [4.0, 6.0, 9.0, 13.0, 20.0, 30.0]
                .into_iter()
                .enumerate()
                .map(|(i, width)| (width / 2.0, 15.0 * i as f64 - 30.0))
                .map(|(half, degrees)| (0.85, rectangle(0.35, [half, 0.4 * short], degrees)))
                .collect(),
        };
        plates.sort_by(|a, b| b.0.total_cmp(&a.0));
        let ground = (0.1, None);
        let all = plates.into_iter().map(|(nearness, outline)| (nearness, Some(outline))).chain([ground]);
        // Neighbours in depth differ in brightness: an edge is seen even where the textures happen to agree.
        let layer = |(i, (nearness, outline)): (usize, (f64, Option<Rectangle>))| Layer {
            depth: far - (far - near) * nearness,
            outline,
            mean: if i % 2 == 0 { 0.62 } else { 0.38 },
            offset: offset(i),
        };
        all.enumerate().map(layer).collect()
    }
}

/// Of layer `i`, on a ring of 48 px by the golden angle: any two of nine are 17 px or more apart, which is further than the
/// texture's longest correlation.
fn offset(i: usize) -> [f64; 2] {
    let (sin, cos) = (2.399_963 * i as f64).sin_cos();
    [48.0 * cos, 48.0 * sin]
}

/// The layer that the middle of the lens sees at a place of I1.
pub(super) fn seen(layers: &[Layer], place: [f64; 2]) -> &Layer {
    let front = layers.iter().find(|layer| layer.outline.is_none_or(|outline| outline.contains(place)));
    front.unwrap_or(&layers[layers.len() - 1])
}
