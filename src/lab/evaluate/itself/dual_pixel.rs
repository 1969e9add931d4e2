//! Real asymmetric blur: a sharp photograph against the views through either half of the aperture, each with its own
//! measured kernel.

use std::path::Path;

use super::truth::by_itself;
use crate::base::{Error, Frame, Homography, Samples};
use crate::engine::Solution;
use crate::files::image_io;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::section::{Case, Section};

const FOLDER: &str = "dual-pixel";
const SCENES: [&str; 2] = ["001", "002"];
const VIEWS: [&str; 2] = ["left", "right"];

/// A grey value of objects.png is an object where it covers more of the frame than this.
const LEAST_OBJECT: f64 = 0.01;

/// The two scenes through either half.
pub(super) fn section(bench: &mut Bench, data: &Path) -> Section {
    // A view takes longer than all of the rest of a quick run.
    let scenes = if bench.quick { &SCENES[..0] } else { &SCENES[..] };
    let cases = scenes.iter().flat_map(|scene| cases(bench, &data.join(FOLDER), scene)).collect();
    let what = "Sharp photographs against half-aperture views of a Pixel 4, each view with its own kernel. Objects by \
                objects.png, from the least blurred: the median of V of each; how far its 5th to 95th percentile of V \
                spreads, at worst, over the range between objects; how many neighbours are in the wrong order. The \
                photographs are of one exposure on one sensor, so both views must be registered alike."
        .to_string();
    Section { name: "Dual pixel", what, cases }
}

fn cases(bench: &mut Bench, folder: &Path, scene: &str) -> Vec<Case> {
    let mut cases = Vec::new();
    let mut transforms = Vec::new();
    for view in VIEWS {
        let name = format!("{scene}, {view}");
        bench.say(&format!("itself: dual pixel {name}"));
        let solved = View::read(folder, scene, view).and_then(|read| read.solve(bench));
        cases.push(match solved {
            Ok((solution, objects)) => {
                transforms.push((solution.transform, [solution.width, solution.height]));
                objects.case(name)
            }
            Err(e) => Case::failed(name, e),
        });
    }
    if let [(left, [width, height]), (right, _)] = transforms[..] {
        let distance = left.corner_distance(right, width, height);
        let told = |t: &Homography| {
            let [tx, ty] = t.translation();
            format!("({tx:.2}, {ty:.2}) px, {:.3} %", 100.0 * (t.scale() - 1.0))
        };
        let note = format!("T {} and {}", told(&left), told(&right));
        cases.push(Case::new(format!("{scene}, left and right")).at_most("corner, px", distance, 0.4).note(note));
    }
    cases
}

/// What is read for one solve.
struct View {
    images: [Frame; 2],
    kernel: crate::base::Kernel,
    labels: Vec<u8>,
}

impl View {
    fn read(folder: &Path, scene: &str, view: &str) -> Result<Self, String> {
        let read = || {
            let file = |name: &str| folder.join(scene).join(format!("{name}.png"));
            let (sharp, seen) = image_io::read_pair(&file("sharp"), &file(view))?;
            let kernel = image_io::read_kernel(&folder.join(format!("kernel_{view}.png")))?;
            let objects = image_io::read(&file("objects"))?;
            let labels = match objects.samples() {
                Samples::U8(labels) if labels.len() == (sharp.width() * sharp.height()) as usize => labels.clone(),
                _ => return Err(Error::file(&file("objects"), "must be grey, of 8 bits and the photograph's size")),
            };
            Ok(Self { images: [sharp, seen], kernel, labels })
        };
        read().map_err(|e: Error| e.to_string())
    }

    fn solve(&self, bench: &mut Bench) -> Result<(Solution, Objects), String> {
        let [sharp, seen] = &self.images;
        let solution = bench.solve([sharp, seen], &by_itself(&self.kernel))?;
        let objects = Objects::of(&self.labels, &solution.relative_blur);
        Ok((solution, objects))
    }
}

/// The 5th, 50th and 95th percentile of V of each object, px², from the least blurred.
#[derive(Debug, PartialEq)]
struct Objects(Vec<[f64; 3]>);

impl Objects {
    /// Of labels that rise with blur, 0 where nothing is known.
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

    fn case(&self, name: String) -> Case {
        let medians: Vec<f64> = self.0.iter().map(|o| o[1]).collect();
        let (low, high) = medians.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
        let widest = self.0.iter().map(|o| o[2] - o[0]).fold(0.0, f64::max);
        // What is not greater, NaN too, is out of order.
        let disorder = medians.windows(2).filter(|w| w[1].partial_cmp(&w[0]).is_none_or(|o| o.is_lt())).count();
        let told: Vec<String> = self.0.iter().map(|[a, m, b]| format!("{m:.1} ({a:.1} to {b:.1})")).collect();
        let case = Case::new(name).at_most("spread over range", widest / (high - low), 0.5);
        case.at_most("out of order", disorder as f64, 0.0).note(format!("V {}", told.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_plateaus_in_the_order_of_their_labels() {
        let labels: Vec<u8> = (0..400).map(|i| [0, 9, 5, 200][i / 100]).chain([7]).collect();
        let v: Vec<f32> =
            (0..401).map(|i| [f32::NAN, 4.0, 2.0, 3.0, 0.0][i / 100] + (i % 100) as f32 / 100.0).collect();
        let objects = Objects::of(&labels, &v);
        let middles: Vec<f64> = objects.0.iter().map(|o| (100.0 * o[1]).round() / 100.0).collect();
        assert_eq!(middles, [2.5, 4.5, 3.5]);
        let case = objects.case("x".to_string());
        assert_eq!(case.figures.iter().map(|f| f.met).collect::<Vec<_>>(), [Some(true), Some(false)]);
        assert!((case.figures[0].value.unwrap() - 0.45).abs() < 1e-6);
    }
}
