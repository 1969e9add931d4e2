//! What the surface of a scene looks like.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::dots::Dots;
use super::kernel::Rules;
use super::raster::Raster;
use super::view::Row;
use super::waves::Waves;
use super::{Kernel, Scene};
use crate::base::{Error, Frame, Samples};
use crate::files::image_io;

/// What is on the surface, as it would look in focus: a continuous function of the place, in [0, 1].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Radiance {
    /// 480 random cosines with correlation lengths of 0.7 to 10 px. Closed form: blurred and read without error.
    Texture,
    /// Squares of 4 px, black or white at random, softened by a Gaussian of σ 0.6 px. The blur is integrated over the
    /// continuous pattern, to 1e-5.
    Dots,
    /// An image, grey or colour, through the cubic spline of its pixels. The blur is integrated over the spline, to
    /// 1e-4 even of noise from pixel to pixel.
    File {
        /// The image, of the scene's size.
        path: PathBuf,
    },
}

/// Radiance made ready: one channel.
pub(super) enum Pattern {
    Waves(Waves),
    Dots(Dots),
    Raster(Raster),
}

impl Radiance {
    /// The channels of a scene's radiance, 1 or 3.
    pub(super) fn channels(&self, scene: &Scene) -> Result<Vec<Pattern>, Error> {
        let size = [scene.width, scene.height];
        Ok(match self {
            Radiance::Texture => vec![Pattern::Waves(Waves::new(scene.seed, size))],
            Radiance::Dots => vec![Pattern::Dots(Dots::new(scene.seed, size))],
            Radiance::File { path } => rasters(&read_sized(path, size)?),
        })
    }
}

impl Pattern {
    /// One row of an image of this pattern.
    pub(super) fn fill(&self, kernel: Kernel, rules: &Rules, row: &Row, values: &mut [f64]) {
        match self {
            Pattern::Waves(waves) => waves.fill(kernel, row, values),
            Pattern::Dots(dots) => gather(|x| dots.at(x), rules, row, values),
            Pattern::Raster(raster) if kernel == Kernel::Gaussian => {
                for (i, (value, v)) in values.iter_mut().zip(row.variances).enumerate() {
                    *value = raster.gaussian(row.place(i), row.view.length(v.sqrt()));
                }
            }
            Pattern::Raster(raster) => gather(|x| raster.at(x), rules, row, values),
        }
    }
}

/// `∫ h(u; v) r(x - M u) du` at each pixel of a row.
fn gather(radiance: impl Fn([f64; 2]) -> f64, rules: &Rules, row: &Row, values: &mut [f64]) {
    for (i, (value, v)) in values.iter_mut().zip(row.variances).enumerate() {
        let (x, sigma) = (row.place(i), v.sqrt());
        *value = if sigma == 0.0 {
            radiance(x)
        } else {
            let at = |u: [f64; 2]| {
                let [dx, dy] = row.view.turn([sigma * u[0], sigma * u[1]]);
                radiance([x[0] - dx, x[1] - dy])
            };
            rules.of(sigma).iter().map(|node| node.weight * at(node.u)).sum()
        };
    }
}

/// Reads an image that must have the scene's size.
pub(super) fn read_sized(path: &Path, [width, height]: [u32; 2]) -> Result<Frame, Error> {
    let frame = image_io::read(path)?;
    if (frame.width(), frame.height()) == (width, height) {
        return Ok(frame);
    }
    let (w, h) = (frame.width(), frame.height());
    Err(Error::file(path, format!("is {w}x{h} and the scene {width}x{height}; radiance and shape must have one size")))
}

fn rasters(frame: &Frame) -> Vec<Pattern> {
    let values: Vec<f64> = match frame.samples() {
        Samples::U8(s) => s.iter().map(|&v| f64::from(v) / 255.0).collect(),
        Samples::U16(s) => s.iter().map(|&v| f64::from(v) / 65535.0).collect(),
        Samples::F32(s) => s.iter().map(|&v| f64::from(v)).collect(),
    };
    let count = frame.format().channels.count() as usize;
    let channel = |c: usize| values.iter().skip(c).step_by(count).copied().collect();
    let raster = |c| Pattern::Raster(Raster::new(channel(c), frame.width() as usize, frame.height() as usize));
    (0..count).map(raster).collect()
}

#[cfg(test)]
mod tests {
    use super::super::view::View;
    use super::*;
    use crate::base::Similarity;

    const KERNELS: [Kernel; 3] = [Kernel::Gaussian, Kernel::Pillbox, Kernel::HalfGaussian];

    #[test]
    fn quadrature_and_closed_form_agree_on_a_texture() {
        let (size, waves) = ([48, 4], Waves::new(3, [48, 4]));
        for kernel in KERNELS {
            let view = View::new(&Similarity::new(1.3, -0.9, 10.0, 1.1), size);
            let variances: Vec<f64> = (0..48).map(|i| 0.2 * f64::from(i)).collect();
            let row = view.row(2, &variances);
            let (mut exact, mut summed) = (vec![0.0; 48], vec![0.0; 48]);
            waves.fill(kernel, &row, &mut exact);
            gather(|x| waves.at(x), &Rules::new(kernel, 3.1), &row, &mut summed);
            let worst = exact.iter().zip(&summed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-6, "{kernel:?}: {worst}");
        }
    }

    #[test]
    fn a_step_under_each_kernel_is_its_line_integral() {
        // A soft step at x = 0, blurred along x: for the Gaussian the variances add, for the half-Gaussian the centroid
        // moves by σ √(2/π) to the right.
        let soft = |x: f64, v: f64| libm::erfc(-x / (2.0 * v).sqrt()) / 2.0;
        let (view, variances) = (View::new(&Similarity::new(0.0, 0.0, 0.0, 1.0), [801, 1]), [6.25; 801]);
        let row = Row { view: &view, start: [-40.0, 0.0], step: [0.1, 0.0], variances: &variances };
        for kernel in KERNELS {
            let mut values = vec![0.0; 801];
            gather(|x| soft(x[0], 0.36), &Rules::new(kernel, 2.5), &row, &mut values);
            if kernel == Kernel::Gaussian {
                for (i, value) in values.iter().enumerate() {
                    assert!((value - soft(row.place(i)[0], 0.36 + 6.25)).abs() < 1e-6);
                }
            }
            // The derivative of the step response is the line spread function: its mean and second moment.
            let spread: Vec<(f64, f64)> =
                (0..800).map(|i| (row.place(i)[0] + 0.05, values[i + 1] - values[i])).collect();
            let moment = |power: i32| spread.iter().map(|(x, d)| x.powi(power) * d).sum::<f64>();
            let mean = if kernel == Kernel::HalfGaussian { 2.5 * (2.0 / std::f64::consts::PI).sqrt() } else { 0.0 };
            assert!((moment(0) - 1.0).abs() < 1e-6);
            assert!((moment(1) - mean).abs() < 1e-4, "{kernel:?}: {}", moment(1));
            // Differences over a tenth add a box of variance 0.01/12.
            let second = 0.36 + 6.25 + 0.01 / 12.0;
            assert!((moment(2) - second).abs() < 1e-3, "{kernel:?}: {}", moment(2));
        }
    }

    #[test]
    fn dots_under_an_asymmetric_kernel_turn_with_the_sensor() {
        // The image of a pattern p under a sensor turned by a right angle is that of the turned pattern.
        let dots = Dots::new(5, [64, 64]);
        let quarter = View::new(&Similarity::new(0.0, 0.0, 90.0, 1.0), [64, 64]);
        let rules = Rules::new(Kernel::HalfGaussian, 2.5);
        let variances = [6.25; 64];
        let mut turned = [0.0; 64];
        gather(|x| dots.at(x), &rules, &quarter.row(20, &variances), &mut turned);
        let upright = View::new(&Similarity::IDENTITY, [64, 64]);
        let mut expected = [0.0; 64];
        gather(|q| dots.at(quarter.place(q)), &rules, &upright.row(20, &variances), &mut expected);
        let worst = turned.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-9, "{worst}");
    }
}
