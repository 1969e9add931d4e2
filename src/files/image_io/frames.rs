//! The frames of a sweep from their files.

use std::path::PathBuf;

use super::{Input, Photograph};
use crate::base::{Error, Frame, workers};

/// Decodes frames side by side; also what a report says of each. The first is open already. Besides the frames as many files are in memory
/// as there are processors; pages of one file share its bytes.
///
/// # Errors
/// [`Error::File`], of the first that fails.
pub fn read_frames(first: Photograph, others: &[PathBuf]) -> Result<Vec<(Frame, Input)>, Error> {
    let mut read: Vec<Option<Result<_, Error>>> = (0..=others.len()).map(|_| None).collect();
    let mut last = Some(first.clone());
    let opened = others.iter().map(|path| {
        let photograph = last.take().map_or_else(|| Photograph::open(path), |last| last.open_next(path));
        last = photograph.as_ref().ok().cloned();
        photograph
    });
    workers::for_each([Ok(first)].into_iter().chain(opened).zip(&mut read), |(photograph, read)| {
        *read = Some(photograph.and_then(|photograph| {
            let input = photograph.describe()?;
            Ok((photograph.decode()?, input))
        }));
    });
    read.into_iter().flatten().collect()
}
