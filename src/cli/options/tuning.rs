//! The settings that few need to touch; `docs/method.md` says what each does.

use parfocal::Settings;

use crate::cli::options::headings::FINE_TUNING;

/// Their flags.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct TuningArguments {
    /// Over-relaxation ω of a sweep, 0.01 to 1.99
    #[arg(long, value_name = "W", help_heading = FINE_TUNING, allow_negative_numbers = true,
          default_value_t = Settings::default().over_relaxation)]
    over_relaxation: f64,
    /// On each level the smoothness starts 1 + C times too large, 0 to 1000
    #[arg(long, value_name = "C", help_heading = FINE_TUNING, allow_negative_numbers = true,
          default_value_t = Settings::default().continuation)]
    continuation: f64,
    /// η of the data term's modified L1 norm, intensities, 1e-4 to 1
    #[arg(long, value_name = "E", help_heading = FINE_TUNING, allow_negative_numbers = true,
          default_value_t = Settings::default().data_eta)]
    data_eta: f64,
    /// η of the smoothness term's modified L1 norm, px² a pixel, 1e-4 to 100
    #[arg(long, value_name = "E", help_heading = FINE_TUNING, allow_negative_numbers = true,
          default_value_t = Settings::default().smoothness_eta)]
    smoothness_eta: f64,
    /// ε of the smooth Heaviside, px², 1e-3 to 10
    #[arg(long, value_name = "E", help_heading = FINE_TUNING, allow_negative_numbers = true,
          default_value_t = Settings::default().heaviside_epsilon)]
    heaviside_epsilon: f64,
    /// Largest change of V in one outer iteration, px² of the level, 0.01 to 100
    #[arg(long, value_name = "PX2", help_heading = FINE_TUNING, allow_negative_numbers = true,
          default_value_t = Settings::default().largest_step)]
    largest_step: f64,
    /// Stored value from which on a sample is clipped and carries no weight [default: 255 or 65535; of floats none]
    #[arg(long, value_name = "V", help_heading = FINE_TUNING, allow_negative_numbers = true)]
    white_level: Option<f64>,
    /// Stored value up to which a pixel is clipped if all its samples are [default: 0; of floats none]
    #[arg(long, value_name = "V", help_heading = FINE_TUNING, allow_negative_numbers = true)]
    black_level: Option<f64>,
}

impl TuningArguments {
    /// Puts them into the settings.
    pub(crate) fn apply(&self, settings: &mut Settings) {
        settings.over_relaxation = self.over_relaxation;
        settings.continuation = self.continuation;
        settings.data_eta = self.data_eta;
        settings.smoothness_eta = self.smoothness_eta;
        settings.heaviside_epsilon = self.heaviside_epsilon;
        settings.largest_step = self.largest_step;
        settings.white_level = self.white_level;
        settings.black_level = self.black_level;
    }
}
