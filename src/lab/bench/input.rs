//! What a benchmark measures: its pairs, methods and kernels.

use std::path::Path;

use super::synthetic;
use crate::base::{Channels, Depth, Error, Format, Frame, Homography, Kernel, Method, Settings, Similarity};
use crate::files::image_io;

/// The scene of the synthetic pairs.
pub(super) const SYNTHETIC: &str = "synthetic";

/// The options of a benchmark: every pair is measured with every method and kernel.
#[derive(Clone, Debug)]
pub struct Options {
    /// The pairs to solve, in this order.
    pub inputs: Vec<Input>,
    /// The pairs that the report names as absent.
    pub absent: Vec<String>,
    /// Methods of registration.
    pub methods: Vec<Method>,
    /// Kernels of the blur.
    pub kernels: Vec<Kernel>,
    /// All other settings.
    pub settings: Settings,
    /// Number of solves after the first that are not measured.
    pub warmup: u32,
    /// Number of measured solves, at least one.
    pub repeats: u32,
    /// Whether to time every dispatch, for a trace, instead of only the passes. Timing itself takes time.
    pub traced: bool,
}

/// A pair to solve.
#[derive(Clone, Debug)]
pub enum Input {
    /// A synthetic pair of this width and height, pixels; grey, 16 bits.
    Synthetic([u32; 2]),
    /// Two photographs.
    Photographs {
        /// The name of the scene in the report.
        scene: String,
        /// I1 and I2.
        pair: Box<[Frame; 2]>,
        /// T for the method `aligned`.
        transform: Homography,
    },
}

impl Default for Options {
    /// Two small synthetic pairs by the unified method, with one warm-up and five measured solves.
    fn default() -> Self {
        Self {
            inputs: vec![Input::Synthetic([512, 512]), Input::Synthetic([1024, 1024])],
            absent: Vec::new(),
            methods: vec![Method::Unified],
            kernels: vec![Kernel::Auto],
            settings: Settings::default(),
            warmup: 1,
            repeats: 5,
            traced: false,
        }
    }
}

impl Options {
    /// The settings of each run of a pair.
    pub(super) fn settings_for(&self, input: &Input) -> impl Iterator<Item = Settings> {
        let of = |method, kernel: &Kernel| {
            let mut settings = Settings { method, kernel: kernel.clone(), ..self.settings.clone() };
            if method == Method::Aligned {
                settings.start = input.transform();
            }
            settings
        };
        self.methods.iter().flat_map(move |&method| self.kernels.iter().map(move |kernel| of(method, kernel)))
    }
}

/// Name and files of the pairs that the project ships in its folder `data`, and the arguments of [`Similarity::new`]
/// for their T.
const SHIPPED: [(&str, [&str; 2], [f64; 4]); 2] = [
    ("heatsink", ["heatsink/frame_15.png", "heatsink/frame_30.png"], [0.6, -0.14, 0.007, 1.0075]),
    ("part", ["part/57/I1.png", "part/57/I2.png"], [1.079, -0.2264, 0.20474, 0.993613]),
];

impl Input {
    /// Reads the photographs that the project ships from its folder `data`. Also returns the names of the absent pairs.
    ///
    /// # Errors
    /// As [`image_io::read_pair`], if the files of a pair exist.
    pub fn shipped(data: &Path) -> Result<(Vec<Self>, Vec<String>), Error> {
        let (mut inputs, mut absent) = (Vec::new(), Vec::new());
        for (scene, files, [tx, ty, rotation_deg, scale]) in SHIPPED {
            let [i1, i2] = files.map(|file| data.join(file));
            if i1.is_file() && i2.is_file() {
                let pair = Box::new(image_io::read_pair(&i1, &i2)?.into());
                let transform = Similarity::new(tx, ty, rotation_deg, scale).into();
                inputs.push(Self::Photographs { scene: scene.to_string(), pair, transform });
            } else {
                absent.push(scene.to_string());
            }
        }
        Ok((inputs, absent))
    }

    pub(super) fn scene(&self) -> &str {
        match self {
            Self::Synthetic(_) => SYNTHETIC,
            Self::Photographs { scene, .. } => scene,
        }
    }

    pub(super) fn size(&self) -> [u32; 2] {
        match self {
            Self::Synthetic(size) => *size,
            Self::Photographs { pair, .. } => [pair[0].width(), pair[0].height()],
        }
    }

    pub(super) fn formats(&self) -> [Format; 2] {
        match self {
            Self::Synthetic(_) => [Format { channels: Channels::Gray, depth: Depth::U16 }; 2],
            Self::Photographs { pair, .. } => [pair[0].format(), pair[1].format()],
        }
    }

    pub(super) fn transform(&self) -> Homography {
        match self {
            Self::Synthetic(_) => synthetic::transform().into(),
            Self::Photographs { transform, .. } => *transform,
        }
    }

    pub(super) fn pair(&self) -> Result<[Frame; 2], Error> {
        match self {
            Self::Synthetic(size) => synthetic::pair(*size).map_err(Error::Mismatch),
            Self::Photographs { pair, .. } => Ok((**pair).clone()),
        }
    }
}
