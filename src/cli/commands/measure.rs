//! `parfocal measure`: step heights and profiles of results.

use parfocal::export::Results;

use crate::cli::options::exports::DerivedOutputs;
use crate::cli::options::part::MeasureArguments;
use crate::cli::options::run::ResultsArguments;
use crate::cli::output::destination;
use crate::cli::output::failure::Failure;
use crate::cli::output::numbers::measurements;

/// Measure step heights and profiles in the results of a solve or a sweep.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    of: ResultsArguments,
    #[command(flatten)]
    measure: MeasureArguments,
}

const AFTER_HELP: &str = "\
Results, in the same folder: profile_1.csv and profile_1.png for the first profile, and so on; the numbers also in
report.json. Steps take the place of those measured before, profiles that of profiles.

Standard errors come from the scatter within the regions, and allow for neighbouring pixels being alike. An error that
regions have in common, of the lens or of the model of the blur, is not in them.

Example:
  parfocal measure out --step 40,60,32,32 200,60,32,32 --profile 10,80,300,80,9

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// Reads, measures, writes and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let request = arguments.measure.request();
    if request.is_empty() {
        return Err(Failure::Usage("nothing to measure: give --step or --profile".to_string()));
    }
    let results = &arguments.of.results;
    let out = arguments.of.force.to(results);
    let mut solved = Results::read(results)?;
    destination::check_folder(results)?;
    solved.check_measurements(out, &request)?;
    let measured = request.measure(&solved)?;
    let derived = DerivedOutputs::page(&solved);
    solved.write_measurements(out, &measured, &derived.drawing(None), derived.files(None))?;
    let rows = measurements(&measured);
    let lines: Vec<String> =
        rows.iter().map(|(label, text)| format!("{label:<14} {text}")).chain(derived.warning()).collect();
    arguments.of.report(&lines.join("\n"), &measured)
}
