//! What is asked of a pair: plain, whole, and made of the arguments before any work. `solve` makes one, and `batch` one for
//! all its pairs.

use std::path::PathBuf;

use parfocal::export::{MeasurementRequest, Nearer, Palette};
use parfocal::image_io::Input;
use parfocal::{Lens, Settings, bounded_read};
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::cli::options::lens::{self, PartOfLens};
use crate::cli::options::models::Models;
use crate::cli::options::run::RunArguments;
use crate::cli::options::scope::Part;
use crate::cli::output::destination::ForceArgument;
use crate::cli::output::failure::Failure;

/// The most bytes of a file that decides the results, 4 GiB, as of a photograph.
const MAX_BYTES: u64 = 1 << 32;

/// All that is asked of a pair. What decides the results is serialised, and nothing else.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Request {
    /// The settings, with the contents of the files that are named for kernel and registration.
    pub(crate) settings: Settings,
    /// What photographs without a header hold.
    pub(crate) raw: Option<String>,
    /// Which image is focused nearer, 1 or 2, where that is stated.
    pub(crate) nearer: Option<u8>,
    pub(crate) part: Part,
    /// As much of the lens as is stated, in a file or by flags; depth in mm is then wanted.
    pub(crate) lens: Option<PartOfLens>,
    pub(crate) wanted: MeasurementRequest,
    pub(crate) palette: Palette,
    /// Whether there is report.html.
    pub(crate) page: bool,
    pub(crate) models: Models,
    #[serde(skip)]
    pub(crate) force: ForceArgument,
    /// Files that are read besides photographs, none of which a result may replace.
    #[serde(skip)]
    pub(crate) files: Vec<PathBuf>,
    #[serde(skip)]
    pub(crate) run: RunArguments,
}

impl Request {
    /// Refuses what contradicts itself.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        self.nearer(self.lens.map_or(Ok(None), PartOfLens::if_whole)?.as_ref())?;
        if self.part.crop_valid && !self.wanted.is_empty() {
            let problem = "--crop-valid moves the pixels that --step and --profile name; measure afterwards, with parfocal measure";
            return Err(Failure::Usage(problem.to_string()));
        }
        Ok(())
    }

    /// Which image is focused nearer, by what is stated and by the lens.
    pub(crate) fn nearer(&self, lens: Option<&Lens>) -> Result<Nearer, Failure> {
        lens::nearer(self.nearer, lens)
    }

    /// The lens, with what is not stated as the photographs say.
    pub(crate) fn lens(&self, photographs: &[Input]) -> Result<Option<Lens>, Failure> {
        self.lens.map(|stated| stated.or(PartOfLens::of_photographs(photographs)).whole()).transpose()
    }

    /// SHA-256 of everything but the photographs that decides the results: the version, the request, and the files that it
    /// names; and of what is `more` than a pair has.
    pub(crate) fn digest(&self, more: &[u8]) -> Result<String, Failure> {
        let request = serde_json::to_vec(self).map_err(|e| Failure::Failed(e.to_string()))?;
        let read = |file: PathBuf| {
            let failed =
                |e| Failure::Failed(format!("{}: cannot be read ({e}); check its permissions", file.display()));
            bounded_read::read(&file, MAX_BYTES).map_err(failed)
        };
        let files = self.part.files().into_iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let mut digest = Sha256::new();
        let more = (!more.is_empty()).then(|| more.to_vec());
        for part in [env!("CARGO_PKG_VERSION").into(), request].into_iter().chain(files).chain(more) {
            // With its length, so that no two lists of parts read alike.
            digest.update(part.len().to_le_bytes());
            digest.update(part);
        }
        Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}
