//! The colours of near and far.

use clap::ValueEnum;
use parfocal::export::Palette;

/// How pictures of depth are drawn.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(super) struct ColorsArgument {
    /// Colours from near to far: yellow to purple in even steps for the eye, red to blue as in the paper, or
    /// white to black
    #[arg(long, value_name = "NAME", value_enum, default_value_t = Name::Viridis)]
    colors: Name,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Name {
    Viridis,
    RedBlue,
    Grey,
}

impl ColorsArgument {
    pub(super) fn palette(self) -> Palette {
        match self.colors {
            Name::Viridis => Palette::Viridis,
            Name::RedBlue => Palette::RedBlue,
            Name::Grey => Palette::Grey,
        }
    }
}
