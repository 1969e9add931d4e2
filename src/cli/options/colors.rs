//! The colours of near and far.

use clap::ValueEnum;
use parfocal::export::Palette;

use crate::cli::options::headings::OUTPUT;

/// How pictures of depth are drawn.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct ColorsArgument {
    /// Colours of near and far
    #[arg(long, value_name = "NAME", help_heading = OUTPUT, value_enum, default_value_t = Name::Viridis)]
    colors: Name,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Name {
    /// Near yellow, far purple, in even steps for the eye
    Viridis,
    /// Near red, far blue, as in the paper
    RedBlue,
    /// Near white, far black
    Grey,
}

impl ColorsArgument {
    pub(crate) fn palette(self) -> Palette {
        match self.colors {
            Name::Viridis => Palette::Viridis,
            Name::RedBlue => Palette::RedBlue,
            Name::Grey => Palette::Grey,
        }
    }
}
