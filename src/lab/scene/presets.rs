//! The scenes by name.

use std::path::Path;

use super::{Arrangement, Exposure, Kernel, Radiance, Scene, Shape};
use crate::base::{Error, Lens, Similarity};
use crate::files::image_io;

/// The scenes that need no files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Preset {
    /// Slanted plane: V falls from left to right
    Plane,
    /// I2 under an asymmetric kernel, on a texture: the paper's asymmetric test
    HalfGaussianTexture,
    /// The same on random dots of 4 px, black and white: the most difficult scene
    HalfGaussianDots,
    /// Two cylinders in front of a plane, through a thin lens that breathes: 50 mm, f/5.6, pixels of 0.0075 mm, focused
    /// at 226.5 and 233.5 mm
    Cylinders,
    /// Seven terraces of constant V
    Steps,
    /// Hills and hollows with steep sides
    Relief,
    /// A near card over a far ground, through the lens of the cylinders, with occlusion; the seed places it
    Card,
    /// Plates at eight heights, with the lens and occlusion of card
    Blocks,
    /// Thin bars, 4 to 30 px, with the lens and occlusion of card
    Bars,
}

impl Preset {
    /// Every preset.
    pub const ALL: [Self; 9] = [
        Self::Plane,
        Self::HalfGaussianTexture,
        Self::HalfGaussianDots,
        Self::Cylinders,
        Self::Steps,
        Self::Relief,
        Self::Card,
        Self::Blocks,
        Self::Bars,
    ];

    /// The name on the command line and in `truth.json`.
    pub fn name(self) -> &'static str {
        match self {
            Preset::Plane => "plane",
            Preset::HalfGaussianTexture => "half-gaussian-texture",
            Preset::HalfGaussianDots => "half-gaussian-dots",
            Preset::Cylinders => "cylinders",
            Preset::Steps => "steps",
            Preset::Relief => "relief",
            Preset::Card => "card",
            Preset::Blocks => "blocks",
            Preset::Bars => "bars",
        }
    }

    /// The scene, without noise and with equal exposures; change its fields as needed. It has 256 x 256 px, or 512 x
    /// 512 px with jumps or steep sides. The model of the solver, in which V is constant within a window, is wrong
    /// along these. The resulting error in T decreases as the area without them grows.
    pub fn scene(self) -> Scene {
        let symmetric = |shape| Scene::new(self.name(), shape, Radiance::Texture);
        let large = |shape| Scene { width: 512, height: 512, ..symmetric(shape) };
        let asymmetric = |radiance| Scene {
            kernel: Kernel::HalfGaussian,
            base_blur: 0.0,
            transform: Similarity::new(1.5, -0.7, 0.1, 1.005),
            ..Scene::new(self.name(), Shape::Uniform { variance: 6.25 }, radiance)
        };
        let layered =
            |arrangement| Scene { kernel: Kernel::Pillbox, ..large(Shape::Layers { arrangement, lens: MACRO }) };
        match self {
            Preset::Plane => symmetric(Shape::Plane { limit: 4.0 }),
            Preset::HalfGaussianTexture => asymmetric(Radiance::Texture),
            Preset::HalfGaussianDots => asymmetric(Radiance::Dots),
            Preset::Cylinders => large(Shape::Cylinders { lens: MACRO }),
            Preset::Steps => large(Shape::Steps { limit: 6.0 }),
            Preset::Relief => large(Shape::Relief { limit: 8.0 }),
            Preset::Card => layered(Arrangement::Card),
            Preset::Blocks => layered(Arrangement::Blocks),
            Preset::Bars => layered(Arrangement::Bars),
        }
    }
}

/// A lens of 50 mm at f/5.6 close to its subject. 7 mm between the focus distances give V of ±6 px², with a field of 14
/// mm at 512 px.
const MACRO: Lens = Lens {
    focal_length: 50.0,
    f_number: 5.6,
    pixel_pitch: 0.0075,
    focus: [226.5, 233.5],
    kappa: Lens::DISK,
    telecentric: false,
    field: None,
};

impl Scene {
    /// A scene with the defaults of the symmetric presets: a displacement of (1.3, -0.9) px, a rotation of 0.15°, and a
    /// scale of 1.01, or the breathing of the lens if there is one.
    fn new(name: &str, shape: Shape, radiance: Radiance) -> Self {
        let scale = shape.lens().map_or(1.01, Lens::breathing);
        Self {
            name: name.to_string(),
            width: 256,
            height: 256,
            seed: 1,
            noise_seed: None,
            shape,
            radiance,
            contrast: 0.9,
            kernel: Kernel::Gaussian,
            base_blur: 0.3,
            transform: Similarity::new(1.3, -0.9, 0.15, scale),
            camera_moves: [0.0; 2],
            exposure: Exposure::default(),
            noise: 0.0,
        }
    }

    /// The scene "image": a picture on a shape from another file, with the picture's size.
    ///
    /// # Errors
    /// [`Error::File`] if the picture is not a readable image. Its pixels and the shape are read when the scene is
    /// rendered.
    pub fn image(radiance: &Path, shape: Shape) -> Result<Self, Error> {
        let (width, height) = image_io::size(radiance)?;
        let radiance = Radiance::File { path: radiance.to_path_buf() };
        Ok(Self { width, height, ..Self::new("image", shape, radiance) })
    }
}
