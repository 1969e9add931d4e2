//! Rendered and real photographs: a ray-traced part with its depth, and views through half an aperture.

use std::path::Path;

use nalgebra::{DMatrix, DVector};
use parfocal::{
    Error, Frame, Solution, export::Registration, frame::Samples, image_io, internals::median, settings::Kernel,
    transform::Homography,
};

use super::scenes::{against_best, best_alpha};
use crate::errors::{Coverage, inside};
use crate::pairs::default_settings;
use crate::section::{Case, Runner, Section};

/// Folder of the part within the data folder.
const PART: &str = "part/57";
const PART_NAME: &str = "part 57";
/// Width of the border of the part that is left out, px.
const BORDER: usize = 24;
/// The least difference of depth across an edge whose pixels show both sides, as a share of the range.
const RIM: f64 = 0.05;
/// Noise of the part, white = 1.
const NOISE: f64 = 0.002;

/// The ray-traced part: disk blur, occlusion, noise and exposure, with its depth.
struct Part {
    images: [Frame; 2],
    transform: Homography,
    depth: Vec<f32>,
}

/// Measures the section "Part", and cases of smoothness and of σ. A quick run has no cases of smoothness.
pub(crate) fn part(runner: &mut Runner, data: &Path) -> (Section, Option<Case>, Case) {
    let (mut smoothness, mut sigma) = (None, Case::failed(PART_NAME, "not solved: see Part"));
    let accuracy = runner.case("part", PART_NAME, |runner, case| {
        let part = Part::read(&data.join(PART))?;
        let (images, settings) = (part.images.each_ref(), default_settings(&Kernel::Gaussian));
        let solution = runner.solve(images, &settings)?;
        let depth = Curve::fit(&part.pixels(&solution)).ok_or(FEW)?;
        sigma = part.coverage(&solution)?.all(Case::new(PART_NAME));
        if !runner.quick {
            let rms = |settings: &_| {
                let solution = runner.solve(images, settings).ok();
                solution.and_then(|s| Curve::fit(&part.pixels(&s))).map_or(f64::INFINITY, |curve| curve.rms)
            };
            let best = best_alpha(&settings, NOISE, rms);
            smoothness = Some(against_best(Case::new(format!("{PART_NAME}: depth rms, %")), depth.rms, best));
        }
        let corner = solution.transform.corner_distance(part.transform, solution.width, solution.height);
        let case = case.at_most("corner, px", corner, 0.004).at_most("depth rms, % of range", depth.rms, 2.5);
        let one = Curve::fit(&part.pixels_of_one_depth(&solution)).ok_or(FEW)?;
        let note = format!("depth rms without pixels that show both sides of an edge: {:.2} %", one.rms);
        Ok(case.at_most("depth MAD, % of range", depth.mad, 0.8).note(note))
    });
    let what = format!(
        "A ray-traced part, thin lens, disk blur, occlusion, noise {NOISE}, another exposure. Depth against V by a cubic, \
         {BORDER} px along the border left out: root mean square and median absolute residual, in % of the range of depth."
    );
    (Section::new("Part", what, vec![accuracy]), smoothness, sigma)
}

const FEW: &str = "too few pixels are valid to compare depth with V";

impl Part {
    fn read(folder: &Path) -> Result<Self, String> {
        let read = || {
            let (i1, i2) = image_io::read_pair(&folder.join("I1.png"), &folder.join("I2.png"))?;
            let truth = Registration::read(&folder.join("truth.json"))?;
            let transform = truth.second().map_or(Homography::IDENTITY, |frame| frame.transform);
            let (width, height, depth) = image_io::read_field(&folder.join("depth.exr"))?;
            Ok::<_, Error>((Self { images: [i1, i2], transform, depth }, [width, height]))
        };
        let (part, size) = read().map_err(|e| e.to_string())?;
        let images = [part.images[0].width(), part.images[0].height()];
        if size == images { Ok(part) } else { Err(format!("depth.exr is {size:?} and the images {images:?} px")) }
    }

    /// V and depth of the judged pixels.
    fn pixels(&self, solution: &Solution) -> Vec<[f64; 2]> {
        let both = |i: usize| [solution.relative_blur[i], self.depth[i]].map(f64::from);
        let pixels = inside(solution.width, solution.height, BORDER).map(both);
        pixels.filter(|both| both.iter().all(|v| v.is_finite())).collect()
    }

    /// Those of the judged pixels that show one side of an edge. The depth of the others is the mean of both sides:
    /// some neighbours are nearer, and some farther away, by over [`RIM`] of the range.
    fn pixels_of_one_depth(&self, solution: &Solution) -> Vec<[f64; 2]> {
        let depth = |i: usize| f64::from(self.depth[i]);
        let judged = || inside(solution.width, solution.height, BORDER).filter(|&i| depth(i).is_finite());
        let range = |pixels: &mut dyn Iterator<Item = f64>| {
            pixels.filter(|z| z.is_finite()).fold((f64::MAX, f64::MIN), |(a, b), z| (a.min(z), b.max(z)))
        };
        let (low, high) = range(&mut judged().map(depth));
        let least = RIM * (high - low);
        let is_of_one = |i: usize| {
            let row = solution.width as usize;
            let around = [i - row, i, i + row].into_iter().flat_map(|i| i - 1..=i + 1);
            let (nearer, farther) = range(&mut around.map(depth));
            depth(i) - nearer < least || farther - depth(i) < least
        };
        let pixels = judged().filter(|&i| is_of_one(i)).map(|i| [f64::from(solution.relative_blur[i]), depth(i)]);
        pixels.filter(|both| both.iter().all(|v| v.is_finite())).collect()
    }

    /// The coverage by σ, with the true V from a cubic of depth.
    fn coverage(&self, solution: &Solution) -> Result<Coverage, String> {
        let exchanged: Vec<[f64; 2]> = self.pixels(solution).into_iter().map(|[v, z]| [z, v]).collect();
        let curve = Curve::fit(&exchanged).ok_or(FEW)?;
        let error = |i: usize| f64::from(solution.relative_blur[i]) - curve.at(f64::from(self.depth[i]));
        let pixels = inside(solution.width, solution.height, BORDER);
        Ok(Coverage::of(pixels.map(|i| (error(i), f64::from(solution.uncertainty[i])))))
    }
}

/// A cubic through points (x, y), by least squares.
struct Curve {
    /// Coefficients of the powers of (x - middle)/spread.
    coefficients: [f64; 4],
    middle: f64,
    spread: f64,
    /// Root mean square and median absolute residual of y, in % of y's range.
    rms: f64,
    mad: f64,
}

impl Curve {
    fn fit(points: &[[f64; 2]]) -> Option<Self> {
        let count = points.len() as f64;
        let middle = points.iter().map(|p| p[0]).sum::<f64>() / count;
        let spread = (points.iter().map(|p| (p[0] - middle).powi(2)).sum::<f64>() / count).sqrt();
        let powers = |x: f64| [0, 1, 2, 3].map(|n| ((x - middle) / spread).powi(n));
        let (mut normal, mut right) = (DMatrix::zeros(4, 4), DVector::zeros(4));
        for [x, y] in points {
            let row = DVector::from_row_slice(&powers(*x));
            right += *y * &row;
            normal += &row * row.transpose();
        }
        let solved = normal.cholesky()?.solve(&right);
        let coefficients = std::array::from_fn(|n| solved[n]);
        let mut curve = Self { coefficients, middle, spread, rms: 0.0, mad: 0.0 };
        let (low, high) = points.iter().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[1]), b.max(p[1])));
        let off: Vec<f64> = points.iter().map(|p| 100.0 * (p[1] - curve.at(p[0])).abs() / (high - low)).collect();
        curve.rms = (off.iter().map(|r| r * r).sum::<f64>() / count).sqrt();
        curve.mad = median(off)?;
        Some(curve)
    }

    fn at(&self, x: f64) -> f64 {
        let x = (x - self.middle) / self.spread;
        self.coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
    }
}

/// Folder of the dual-pixel data.
const DUAL_PIXEL: &str = "dual-pixel";
const SCENES: [&str; 2] = ["001", "002"];
const VIEWS: [&str; 2] = ["left", "right"];

/// Least share of the frame that a grey value of objects.png must cover to count as an object.
const LEAST_OBJECT: f64 = 0.01;

/// Measures real asymmetric blur, with measured kernels: a sharp photograph against the view through each half of the
/// aperture.
pub(crate) fn dual_pixel(runner: &mut Runner, data: &Path) -> Section {
    // One view takes longer than all other cases of a quick run.
    let scenes = if runner.quick { &SCENES[..0] } else { &SCENES[..] };
    let cases = scenes.iter().flat_map(|scene| dual_pixel_scene(runner, &data.join(DUAL_PIXEL), scene)).collect();
    let what = "Sharp photographs against half-aperture views of a Pixel 4, each view with its own kernel. Objects by \
                objects.png, from the least blurred: the median of V of each; how far its 5th to 95th percentile of V \
                spreads, at worst, over the range between objects; how many neighbours are in the wrong order. The \
                photographs are of one exposure on one sensor, so both views must be registered alike.";
    Section::new("Dual pixel", what, cases)
}

fn dual_pixel_scene(runner: &mut Runner, folder: &Path, scene: &str) -> Vec<Case> {
    let mut cases = Vec::new();
    let mut transforms = Vec::new();
    for view in VIEWS {
        cases.push(runner.case("dual pixel", format!("{scene}, {view}"), |runner, case| {
            let View { images, kernel, labels } = View::read(folder, scene, view).map_err(|e| e.to_string())?;
            let solution = runner.solve(images.each_ref(), &default_settings(&kernel))?;
            transforms.push((solution.transform, [solution.width, solution.height]));
            Ok(Objects::of(&labels, &solution.relative_blur).case(case))
        }));
    }
    if let [(left, [width, height]), (right, _)] = transforms[..] {
        let distance = left.corner_distance(right, width, height);
        let text = |t: &Homography| {
            let [tx, ty] = t.translation();
            format!("({tx:.2}, {ty:.2}) px, {:.3} %", 100.0 * (t.scale() - 1.0))
        };
        let note = format!("T {} and {}", text(&left), text(&right));
        cases.push(Case::new(format!("{scene}, left and right")).at_most("corner, px", distance, 0.4).note(note));
    }
    cases
}

/// The files of one view.
struct View {
    images: [Frame; 2],
    kernel: Kernel,
    labels: Vec<u8>,
}

impl View {
    fn read(folder: &Path, scene: &str, view: &str) -> Result<Self, Error> {
        let file = |name: &str| folder.join(scene).join(format!("{name}.png"));
        let (sharp, blurred) = image_io::read_pair(&file("sharp"), &file(view))?;
        let kernel = image_io::read_kernel(&folder.join(format!("kernel_{view}.png")))?;
        let objects = image_io::read(&file("objects"))?;
        let labels = match objects.samples() {
            Samples::U8(labels) if labels.len() == (sharp.width() * sharp.height()) as usize => labels.clone(),
            _ => {
                let problem = "must be grey, of 8 bits and the photograph's size".to_string();
                return Err(Error::File { path: file("objects"), problem });
            }
        };
        Ok(Self { images: [sharp, blurred], kernel, labels })
    }
}

/// The 5th, 50th and 95th percentile of V of each object, px², beginning with the least blurred.
#[derive(Debug, PartialEq)]
struct Objects(Vec<[f64; 3]>);

impl Objects {
    /// Computes the percentiles for labels that increase with blur. The label 0 marks pixels of no known object.
    fn of(labels: &[u8], relative_blur: &[f32]) -> Self {
        let mut values: Vec<Vec<f64>> = vec![Vec::new(); 256];
        let mut sizes = [0usize; 256];
        for (label, v) in labels.iter().zip(relative_blur).filter(|(label, _)| **label > 0) {
            sizes[usize::from(*label)] += 1;
            values[usize::from(*label)].extend(v.is_finite().then_some(f64::from(*v)));
        }
        let least = LEAST_OBJECT * labels.len() as f64;
        let objects = values.into_iter().zip(sizes).filter(|(_, size)| *size as f64 > least);
        let percentiles = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            let at = |share: f64| values.get((share * values.len() as f64) as usize).copied().unwrap_or(f64::NAN);
            [0.05, 0.5, 0.95].map(at)
        };
        Self(objects.map(|(values, _)| percentiles(values)).collect())
    }

    /// Adds the spread and the order of V of the objects.
    fn case(&self, case: Case) -> Case {
        let medians: Vec<f64> = self.0.iter().map(|o| o[1]).collect();
        let (low, high) = medians.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
        let widest = self.0.iter().map(|o| o[2] - o[0]).fold(0.0, f64::max);
        // A median is out of order if it is NaN or not greater than the previous one.
        let disorder = medians.windows(2).filter(|w| w[1].partial_cmp(&w[0]).is_none_or(|o| o.is_lt())).count();
        let objects: Vec<String> = self.0.iter().map(|[a, m, b]| format!("{m:.1} ({a:.1} to {b:.1})")).collect();
        let case = case.at_most("spread over range", widest / (high - low), 0.5);
        case.at_most("out of order", disorder as f64, 0.0).note(format!("V {}", objects.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_recovered_and_residuals_are_shares_of_the_range() {
        let cubic = |x: f64| 2.0 - x + 0.5 * x * x - 0.25 * x * x * x;
        let exact: Vec<[f64; 2]> = (0..101).map(|i| f64::from(i) / 50.0 - 1.0).map(|x| [x, cubic(x)]).collect();
        let curve = Curve::fit(&exact).unwrap();
        assert!((curve.at(0.3) - cubic(0.3)).abs() < 1e-12 && curve.rms < 1e-9);
        let one_off = exact.iter().enumerate().map(|(i, [x, y])| [*x, y + if i == 50 { 1.0 } else { 0.0 }]);
        let curve = Curve::fit(&one_off.collect::<Vec<_>>()).unwrap();
        assert!(curve.rms > 2.0 && curve.mad < 1.0, "{} {}", curve.rms, curve.mad);
        assert!(Curve::fit(&[]).is_none());
    }

    #[test]
    fn objects_have_plateaus_of_v_in_the_order_of_their_labels() {
        let labels: Vec<u8> = (0..400).map(|i| [0, 9, 5, 200][i / 100]).chain([7]).collect();
        let v: Vec<f32> =
            (0..401).map(|i| [f32::NAN, 4.0, 2.0, 3.0, 0.0][i / 100] + (i % 100) as f32 / 100.0).collect();
        let objects = Objects::of(&labels, &v);
        let middles: Vec<f64> = objects.0.iter().map(|o| (100.0 * o[1]).round() / 100.0).collect();
        assert_eq!(middles, [2.5, 4.5, 3.5]);
        let case = objects.case(Case::new("x"));
        assert_eq!(case.values.iter().map(|f| f.met).collect::<Vec<_>>(), [Some(true), Some(false)]);
        assert!((case.values[0].value.unwrap() - 0.45).abs() < 1e-6);
    }
}
