//! Flat layers through a thin lens, with occlusion: each ray through the lens shows the first layer that it meets.
//!
//! Consider a ray through the point u of the lens, where u has unit variance along each axis like the kernel. By this
//! ray, pixel q of image i sees the following point of the layer at depth z:
//!
//! ```text
//! p = x - M u σ_i(z),   x = T⁻¹ q,   σ_i(z) = s_i κ a_i/pitch (X(z) - X(u_i))
//! ```
//!
//! This is exact: rays are straight, and points are stated as the middle of the lens sees them on I1. The sign of σ_i
//! is the side of the focus on which the layer is: beyond the focus the cone of rays is inverted. Where the whole cone
//! meets one layer, its texture has a closed form. Elsewhere the colour is a quadrature over the aperture. The base
//! blur softens textures and edges, so that the quadrature converges: its error is below 1e-3.

use std::sync::Arc;

use serde::Serialize;

use super::kernel::{Kernel, Rules};
use super::radiance::Waves;
use super::raster::Raster;
use super::view::{Row, View, fill_rows};
use crate::base::random::Random;
use crate::base::{Lens, centre};

/// An arrangement of layers in front of the background. The seed places them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Arrangement {
    /// One large near card in front of a far background.
    Card,
    /// Eight plates at different heights with the same rotation, as on a machined part.
    Blocks,
    /// Thin near bars of 4 to 30 px in front of a far background.
    Bars,
}

/// A flat layer, perpendicular to the axis of the lens.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layer {
    /// Distance from the lens, mm.
    pub(super) depth: f64,
    /// Its outline; `None` for the background.
    pub(super) outline: Option<Rectangle>,
    /// The mean radiance, around which its texture varies.
    pub(super) mean: f64,
    /// Offset of its texture, px of I1. It differs between layers, so that no two have the same texture.
    pub(super) offset: [f64; 2],
}

/// A rectangle as seen by the middle of the lens, px of I1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    pub(super) centre: [f64; 2],
    /// Half of the side lengths.
    pub(super) half: [f64; 2],
    /// Cosine and sine of the angle between its first side and the rows.
    pub(super) direction: [f64; 2],
}

impl Layer {
    /// Displaces the layer and its texture, px of I1.
    pub(super) fn displace(&mut self, [right, down]: [f64; 2]) {
        self.offset = [self.offset[0] - right, self.offset[1] - down];
        if let Some(outline) = &mut self.outline {
            outline.centre = [outline.centre[0] + right, outline.centre[1] + down];
        }
    }
}

impl Rectangle {
    /// Distance of a position from the nearest edges along both sides; negative outside.
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
    /// The layers, nearest first; the background is the last. Depths are between the focus distances of the lens.
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
        // Nearness: 0 at the far focus, 1 at the near one.
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
        // Neighbours in depth differ in brightness, so that an edge is visible even where the textures are equal.
        let layer = |(i, (nearness, outline)): (usize, (f64, Option<Rectangle>))| Layer {
            depth: far - (far - near) * nearness,
            outline,
            mean: if i % 2 == 0 { 0.62 } else { 0.38 },
            offset: offset(i),
        };
        all.enumerate().map(layer).collect()
    }
}

/// The offset of the texture of layer `i`, on a ring of 48 px, by the golden angle. Any two of nine offsets are at
/// least 17 px apart, more than the longest correlation length of the texture.
fn offset(i: usize) -> [f64; 2] {
    let (sin, cos) = (2.399_963 * i as f64).sin_cos();
    [48.0 * cos, 48.0 * sin]
}

/// The layer that the middle of the lens sees at a position of I1.
pub(super) fn front(layers: &[Layer], place: [f64; 2]) -> &Layer {
    let front = layers.iter().find(|layer| layer.outline.is_none_or(|outline| outline.contains(place)));
    front.unwrap_or(&layers[layers.len() - 1])
}

/// Layers ready to be rendered.
#[derive(Clone)]
pub(super) struct Layered {
    layers: Vec<Layer>,
    /// The texture softened by the base blur.
    waves: Arc<Waves>,
    /// Samples of this texture, [`FINE`] per pixel, beginning [`MARGIN`] px outside the frame.
    raster: Arc<Raster>,
    /// Standard deviation of the base blur, px.
    softness: f64,
    kernel: Kernel,
    size: [u32; 2],
}

/// Samples of the texture per pixel. The error of a cubic spline through them is below 1e-4.
const FINE: usize = 2;
/// Margin of the samples around the frame, px: the offset of a texture, 48, and the reach of blur and displacement.
const MARGIN: usize = 80;
/// Distance at which a softened edge is cut off, in standard deviations of the base blur: 3e-5 of its height remain.
const EDGE: f64 = 4.0;
/// Fraction of the bandwidth of the kernel's quadrature rules that is used: edges are softer than the rules assume.
const BANDWIDTH: f64 = 2.0 / 3.0;

/// The fraction of a cone of rays that meets a layer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Share {
    None,
    Some,
    All,
}

impl Layered {
    pub(super) fn new(layers: Vec<Layer>, seed: u64, size: [u32; 2], base_blur: f64, kernel: Kernel) -> Self {
        let waves = Waves::new(seed, size).softened(base_blur);
        let fine = size.map(|length| (length + 2 * MARGIN as u32) * FINE as u32);
        let view = View::new(&crate::base::Similarity::IDENTITY, size);
        let (step, sharp) = (1.0 / FINE as f64, vec![0.0; fine[0] as usize]);
        let values = fill_rows(fine, |y, values| {
            let start = [-(MARGIN as f64), y as f64 * step - MARGIN as f64];
            waves.fill(kernel, &Row { view: &view, start, step: [step, 0.0], variances: &sharp }, values);
        });
        let raster = Arc::new(Raster::new(values, fine[0] as usize, fine[1] as usize));
        Self { layers, waves: Arc::new(waves), raster, softness: base_blur.sqrt(), kernel, size }
    }

    /// The layers after a change of where they are, with the same texture.
    pub(super) fn changed(&self, change: impl FnOnce(&mut [Layer])) -> Self {
        let mut changed = self.clone();
        change(&mut changed.layers);
        changed
    }

    /// Renders one image from its view and the signed standard deviation of each layer's blur on the sensor, px.
    pub(super) fn image(&self, view: &View, sigmas: &[f64]) -> Vec<f64> {
        let widest = sigmas.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        let rules = Rules::new(self.kernel, BANDWIDTH * widest);
        let reaches: Vec<f64> = sigmas.iter().map(|s| self.kernel.reach() * view.length(s.abs())).collect();
        fill_rows(self.size, |y, values| {
            let row = view.row(y, &[]);
            let mut clear: Vec<Option<Vec<f64>>> = vec![None; self.layers.len()];
            for (i, value) in values.iter_mut().enumerate() {
                let place = row.place(i);
                let share = |k: usize| self.share(&self.layers[k], place, reaches[k]);
                let met: Vec<(usize, Share)> =
                    (0..sigmas.len()).map(|k| (k, share(k))).filter(|(_, share)| *share != Share::None).collect();
                *value = match met[0] {
                    (k, Share::All) => clear[k].get_or_insert_with(|| self.clear(k, view, y, sigmas[k]))[i],
                    _ => self.summed(&met, &rules, view, place, sigmas),
                };
            }
        })
    }

    fn share(&self, layer: &Layer, place: [f64; 2], reach: f64) -> Share {
        let Some(outline) = &layer.outline else { return Share::All };
        let (reach, [a, b]) = (reach + EDGE * self.softness, outline.depth_inside(place));
        match a.min(b) {
            inside if inside > reach => Share::All,
            inside if inside < -reach => Share::None,
            _ => Share::Some,
        }
    }

    /// Renders a part of a row where one layer is visible and no other hides it.
    fn clear(&self, k: usize, view: &View, y: usize, sigma: f64) -> Vec<f64> {
        let (width, layer) = (self.size[0] as usize, &self.layers[k]);
        let variances = vec![sigma * sigma; width];
        let row = view.row(y, &variances);
        let start = [row.start[0] + layer.offset[0], row.start[1] + layer.offset[1]];
        let mut values = vec![0.0; width];
        self.waves.fill(self.kernel, &Row { start, ..row }, &mut values);
        values.iter_mut().for_each(|v| *v = layer.radiance(*v));
        values
    }

    /// Renders a pixel with a cone that meets several layers, nearest first.
    fn summed(&self, met: &[(usize, Share)], rules: &Rules, view: &View, x: [f64; 2], sigmas: &[f64]) -> f64 {
        let widest = met.iter().fold(0.0, |most: f64, (k, _)| most.max(sigmas[*k].abs()));
        let rule = rules.of(BANDWIDTH * widest);
        let ray = |u: [f64; 2]| {
            let (mut sum, mut left) = (0.0, 1.0);
            for &(k, share) in met {
                let [dx, dy] = view.turn(u.map(|u| sigmas[k] * u));
                let p = [x[0] - dx, x[1] - dy];
                let layer = &self.layers[k];
                let covered = match &layer.outline {
                    Some(outline) if share == Share::Some => left * self.coverage(outline, p),
                    _ => left,
                };
                if covered > 0.0 {
                    sum += covered * layer.radiance(self.texture([p[0] + layer.offset[0], p[1] + layer.offset[1]]));
                    left -= covered;
                }
                if left < 1e-6 {
                    break;
                }
            }
            sum
        };
        rule.iter().map(|node| node.weight * ray(node.u)).sum()
    }

    /// The coverage at a position of a layer with softened edges.
    fn coverage(&self, outline: &Rectangle, place: [f64; 2]) -> f64 {
        let limit = EDGE * self.softness;
        let along = |d: f64| match d {
            d if d >= limit => 1.0,
            d if d <= -limit => 0.0,
            d => libm::erfc(-d / (2f64.sqrt() * self.softness)) / 2.0,
        };
        let [a, b] = outline.depth_inside(place);
        along(a) * along(b)
    }

    fn texture(&self, place: [f64; 2]) -> f64 {
        let margin = MARGIN as f64;
        let inside = |p: f64, length: u32| p > 2.0 - margin && p < f64::from(length) + margin - 2.0;
        if inside(place[0], self.size[0]) && inside(place[1], self.size[1]) {
            self.raster.at(place.map(|p| (p + margin) * FINE as f64))
        } else {
            // This is rare. The exact texture takes a hundred times as long.
            self.waves.at(place)
        }
    }
}

impl Layer {
    /// The radiance for a value of the texture in [0, 1].
    fn radiance(&self, texture: f64) -> f64 {
        self.mean + CONTRAST * (texture - 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Similarity;

    const SIZE: [u32; 2] = [96, 64];

    fn ground(mean: f64) -> Layer {
        Layer { depth: 230.0, outline: None, mean, offset: [0.0; 2] }
    }

    /// A layer that covers x > 48.
    fn half_plane(mean: f64) -> Layer {
        let outline = Rectangle { centre: [1048.0, 32.0], half: [1000.0, 1000.0], direction: [1.0, 0.0] };
        Layer { outline: Some(outline), ..ground(mean) }
    }

    fn image(layers: Vec<Layer>, kernel: Kernel, sigmas: &[f64]) -> Vec<f64> {
        Layered::new(layers, 3, SIZE, 0.3, kernel).image(&View::new(&Similarity::IDENTITY, SIZE), sigmas)
    }

    #[test]
    fn an_edge_at_the_depth_of_the_background_is_invisible() {
        for kernel in [Kernel::Gaussian, Kernel::Pillbox] {
            for sigma in [0.0, 1.0, 2.5] {
                let alone = image(vec![ground(0.5)], kernel, &[sigma]);
                let both = image(vec![half_plane(0.5), ground(0.5)], kernel, &[sigma, sigma]);
                let worst = alone.iter().zip(&both).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(worst < 2e-4, "{kernel:?}, σ {sigma}: {worst}");
            }
        }
    }

    #[test]
    fn a_blurred_half_plane_over_a_sharp_background_has_the_edge_spread_of_its_kernel() {
        let normal = |d: f64, v: f64| libm::erfc(-d / (2.0 * v).sqrt()) / 2.0;
        let disk = |d: f64, r: f64| {
            let t = (d / r).clamp(-1.0, 1.0);
            0.5 + (t * (1.0 - t * t).sqrt() + t.asin()) / std::f64::consts::PI
        };
        for (kernel, sigma) in [(Kernel::Gaussian, 2.5), (Kernel::Pillbox, 2.5), (Kernel::Pillbox, -2.5)] {
            // The layers differ only in brightness, so the difference is the coverage alone.
            let [bright, dark] =
                [0.7, 0.3].map(|mean| image(vec![half_plane(mean), ground(0.5)], kernel, &[sigma, 0.0]));
            for x in 20..76 {
                let covered = (bright[32 * 96 + x] - dark[32 * 96 + x]) / 0.4;
                let d = x as f64 - 48.0;
                let expected = if kernel == Kernel::Gaussian {
                    normal(d, sigma * sigma + 0.3)
                } else {
                    // The edge of the disk, softened by the base blur: a sum over its Gaussian.
                    let nodes = || (-400..=400).map(|i| f64::from(i) / 100.0);
                    let weight = |t: f64| (-t * t / 2.0).exp();
                    let sum: f64 = nodes().map(|t| weight(t) * disk(d + 0.3f64.sqrt() * t, 2.0 * sigma.abs())).sum();
                    sum / nodes().map(weight).sum::<f64>()
                };
                assert!((covered - expected).abs() < 1e-3, "{kernel:?} {sigma} at {d}: {covered}, not {expected}");
            }
        }
    }

    #[test]
    fn a_sharp_edge_hides_the_blurred_background() {
        for kernel in [Kernel::Gaussian, Kernel::Pillbox] {
            let [bright, dark] = [0.7, 0.3].map(|mean| image(vec![half_plane(0.5), ground(mean)], kernel, &[0.0, 2.5]));
            for x in 0..96 {
                let behind = (bright[32 * 96 + x] - dark[32 * 96 + x]) / 0.4;
                let expected = libm::erfc((x as f64 - 48.0) / 0.6f64.sqrt()) / 2.0;
                assert!((behind - expected).abs() < 1e-4, "{kernel:?} at {x}: {behind}, not {expected}");
            }
        }
    }

    /// Checks that pixels near an edge, which are a quadrature, agree with the closed form.
    #[test]
    fn quadrature_and_closed_form_agree() {
        for kernel in [Kernel::Gaussian, Kernel::Pillbox] {
            // The second shift exceeds the margin of the samples.
            for (shift, sigma) in [(1.3, 0.4), (1.3, 1.7), (-90.0, 1.0), (1.3, 3.0)] {
                let view = View::new(&Similarity::new(shift, -0.9, 5.0, 1.02), SIZE);
                let layers = vec![Layer { offset: [40.0, -20.0], ..ground(0.5) }];
                let layered = Layered::new(layers, 3, SIZE, 0.3, kernel);
                let (rules, clear) = (Rules::new(kernel, BANDWIDTH * sigma), layered.clear(0, &view, 30, sigma));
                for (i, value) in clear.iter().enumerate() {
                    let summed =
                        layered.summed(&[(0, Share::All)], &rules, &view, view.place([i as f64, 30.0]), &[sigma]);
                    assert!((summed - value).abs() < 1e-4, "{kernel:?} σ {sigma} at {i}: {summed}, not {value}");
                }
            }
        }
    }
}
