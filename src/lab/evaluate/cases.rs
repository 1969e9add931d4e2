//! The pairs that are evaluated: scenes, a photograph that was displaced, and photographs.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::bench::{Bench, settings};
use super::displace::{displaced, reduced};
use crate::base::{Error, Frame, Kernel, Method, Similarity};
use crate::files::export::Nearer;
use crate::files::image_io;
use crate::lab::scene::{self, Preset, Scene, Shape};

/// Two photographs of a data set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RealPair {
    pub name: &'static str,
    files: [&'static str; 2],
    /// Whether I1 or I2 is focused nearer. A lens that refocuses moves out for what is near, and magnifies it: where
    /// T has a scale above 1 it is I2.
    pub nearer: Nearer,
}

/// The real pairs; each has a folder of its name.
const PAIRS: [RealPair; 6] = [
    RealPair { name: "heatsink", files: ["frame_15.png", "frame_30.png"], nearer: Nearer::Second },
    RealPair { name: "pcb-header", files: ["pcb_003.jpg", "pcb_005.jpg"], nearer: Nearer::First },
    RealPair { name: "pcb-macro", files: ["pcb_003.JPG", "pcb_006.JPG"], nearer: Nearer::Second },
    RealPair { name: "dimple", files: ["image05.jpg", "image09.jpg"], nearer: Nearer::First },
    RealPair { name: "leaves", files: ["02sm.png", "04sm.png"], nearer: Nearer::First },
    CUP,
];

/// The Watanabe and Nayar pair, which is telecentric and aligned: the paper displaces it.
const CUP: RealPair =
    RealPair { name: "cup", files: ["breakfast_near.png", "breakfast_far.png"], nearer: Nearer::First };

/// A data set that is not there.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Absent {
    pub name: &'static str,
    pub looked_for: Vec<PathBuf>,
}

/// Width that a quick run reduces photographs to, at least, px.
const QUICK_WIDTH: u32 = 240;

impl RealPair {
    fn paths(&self, data: &Path) -> [PathBuf; 2] {
        self.files.map(|file| data.join(self.name).join(file))
    }

    /// The photographs; a quick run reduces them.
    pub(super) fn read(&self, data: &Path, quick: bool) -> Result<[Frame; 2], String> {
        let [first, second] = self.paths(data);
        let (i1, i2) = image_io::read_pair(&first, &second).map_err(|e| e.to_string())?;
        let factor = if quick { (i1.width() / QUICK_WIDTH).max(1) } else { 1 };
        if factor == 1 { Ok([i1, i2]) } else { Ok([reduced(&i1, factor)?, reduced(&i2, factor)?]) }
    }
}

/// The names of all real pairs.
pub(super) fn pair_names() -> impl Iterator<Item = &'static str> {
    PAIRS.into_iter().map(|pair| pair.name)
}

/// The real pairs in a folder, and those that are not there.
pub(super) fn real_pairs(data: &Path) -> (Vec<RealPair>, Vec<Absent>) {
    let (present, absent): (Vec<RealPair>, Vec<RealPair>) =
        PAIRS.iter().partition(|pair| pair.paths(data).iter().all(|path| path.is_file()));
    let missing = |pair: &RealPair| {
        let looked_for = pair.paths(data).into_iter().filter(|path| !path.is_file()).collect();
        Absent { name: pair.name, looked_for }
    };
    (present, absent.iter().map(missing).collect())
}

/// A pair whose registration is known.
pub(super) struct Case {
    pub name: String,
    /// Whether the kernel is its own mirror image.
    pub symmetric: bool,
    source: Source,
}

enum Source {
    Scene(Box<Scene>),
    /// A photograph I2 displaced, in this folder of data.
    Displaced(RealPair, PathBuf),
}

/// The displacement of the Cup, that of the paper's kind.
fn displacement() -> Similarity {
    Similarity::new(1.8, 2.3, 0.2, 1.01)
}

/// The cases of Table 1: scenes with symmetric blur, scenes with asymmetric blur, and the Cup where it is there.
pub(super) fn all(data: &Path, present: &[RealPair], quick: bool) -> Vec<Case> {
    let symmetric: &[Preset] =
        if quick { &[Preset::Plane] } else { &[Preset::Plane, Preset::Relief, Preset::Steps, Preset::Cylinders] };
    let sigmas: &[f64] = if quick { &[2.5] } else { &[1.0, 1.5, 2.5] };
    let asymmetric: &[Preset] =
        if quick { &[Preset::HalfGaussianDots] } else { &[Preset::HalfGaussianTexture, Preset::HalfGaussianDots] };
    let mut cases: Vec<Case> =
        symmetric.iter().map(|preset| scene_case(preset.name(), preset.scene(), quick)).collect();
    for preset in asymmetric {
        for sigma in sigmas {
            let scene = Scene { shape: Shape::Uniform { variance: sigma * sigma }, ..preset.scene() };
            cases.push(scene_case(&format!("{}, σ {sigma}", preset.name()), scene, quick));
        }
    }
    if present.contains(&CUP) {
        let source = Source::Displaced(CUP, data.to_path_buf());
        cases.push(Case { name: "cup, displaced".to_string(), symmetric: true, source });
    }
    cases
}

fn scene_case(name: &str, mut scene: Scene, quick: bool) -> Case {
    if quick {
        (scene.width, scene.height) = (128, 128);
    }
    let symmetric = scene.kernel != scene::Kernel::HalfGaussian;
    Case { name: name.to_string(), symmetric, source: Source::Scene(Box::new(scene)) }
}

/// A pair with its truth.
pub(super) struct Pair {
    pub images: [Frame; 2],
    /// V at each pixel of I1, px², where it is known.
    pub relative_blur: Option<Vec<f32>>,
}

/// A case ready to be solved.
pub(super) struct Prepared {
    pub displaced: Pair,
    /// T of the displaced pair.
    pub truth: Similarity,
    /// The same without displacement.
    pub aligned: Pair,
    pub kernel: Kernel,
}

impl Case {
    /// Whether the registration is known from how the pair was made, and not by solving it.
    pub(super) fn truth_is_known(&self) -> bool {
        matches!(self.source, Source::Scene(_))
    }

    /// Renders, or reads and displaces.
    pub(super) fn prepare(&self, bench: &mut Bench) -> Result<Prepared, String> {
        match &self.source {
            Source::Scene(scene) => rendered(scene).map_err(|e| e.to_string()),
            Source::Displaced(pair, data) => {
                let [i1, i2] = pair.read(data, bench.quick)?;
                // What little the photographs themselves are displaced by is part of the truth.
                let own = bench.solve([&i1, &i2], &settings(Method::Unified, &Kernel::Gaussian))?.transform.at_centre();
                let (by, moved) = (displacement(), displaced(&i2, &displacement())?);
                let displaced = Pair { images: [i1.clone(), moved], relative_blur: None };
                let aligned = Pair { images: [i1, i2], relative_blur: None };
                Ok(Prepared { displaced, truth: by.after(&own), aligned, kernel: Kernel::Gaussian })
            }
        }
    }
}

fn rendered(scene: &Scene) -> Result<Prepared, Error> {
    let pair = |scene: &Scene| {
        let simulated = scene.render()?;
        Ok(Pair { images: [simulated.i1, simulated.i2], relative_blur: Some(simulated.relative_blur) })
    };
    let aligned = pair(&Scene { transform: Similarity::IDENTITY, ..scene.clone() })?;
    Ok(Prepared { displaced: pair(scene)?, truth: scene.transform, aligned, kernel: model(scene.kernel) })
}

/// The solver's kernel of a scene's.
pub(super) fn model(kernel: scene::Kernel) -> Kernel {
    match kernel {
        scene::Kernel::Gaussian => Kernel::Gaussian,
        scene::Kernel::Pillbox => Kernel::Pillbox,
        scene::Kernel::HalfGaussian => Kernel::HalfGaussian,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_absent_is_named_with_its_files() {
        let empty = tempfile::TempDir::new().unwrap();
        let (present, absent) = real_pairs(empty.path());
        assert!(present.is_empty() && absent.len() == PAIRS.len());
        assert_eq!(absent[5].looked_for[0], empty.path().join("cup/breakfast_near.png"));
        assert!(all(empty.path(), &present, false).iter().all(|case| !case.name.contains("cup")));
        let (present, _) = real_pairs(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data"));
        assert_eq!(present.first().map(|pair| pair.name), Some("heatsink"));
    }
}
