//! Parallel loops over the rows of rasters.

use crate::base::workers;

/// The least numbers in a band of rows. For fewer, waking another thread takes longer than it saves.
const BAND: usize = 1 << 14;

/// The numbers of a raster that a loop writes, in rows of `width`.
pub(crate) struct Rows<'a, N> {
    pub(crate) width: usize,
    pub(crate) numbers: &'a mut [N],
}

impl<N> Rows<'_, N> {
    /// Joins `count` rows to one. The last may be shorter.
    pub(crate) fn joined(self, count: usize) -> Self {
        Self { width: count * self.width, ..self }
    }
}

/// Calls `function(y, rows)` with row y of each raster, in parallel over bands of rows. Returns the results in order.
pub(crate) fn map<N: Send, T: Send, const COUNT: usize>(
    rasters: [Rows<'_, N>; COUNT],
    function: impl Fn(usize, [&mut [N]; COUNT]) -> T + Sync,
) -> Vec<T> {
    let widths = rasters.each_ref().map(|rows| rows.width.max(1));
    let rows = BAND.div_ceil(widths.into_iter().max().unwrap_or(1));
    let bands: Vec<_> = chunks(rasters.map(|raster| raster.numbers), widths.map(|width| rows * width)).collect();
    let mut results: Vec<Vec<T>> = bands.iter().map(|_| Vec::new()).collect();
    workers::for_each_short(bands.into_iter().zip(&mut results).enumerate(), |(n, (band, results))| {
        *results = chunks(band, widths).enumerate().map(|(y, row)| function(n * rows + y, row)).collect();
    });
    results.into_iter().flatten().collect()
}

/// The chunks of slices, each of its own size.
fn chunks<N, const COUNT: usize>(
    slices: [&mut [N]; COUNT],
    sizes: [usize; COUNT],
) -> impl Iterator<Item = [&mut [N]; COUNT]> {
    let mut sizes = sizes.into_iter();
    let mut chunks = slices.map(|slice| slice.chunks_mut(sizes.next().unwrap_or(1)));
    std::iter::from_fn(move || {
        let next = chunks.each_mut().map(Iterator::next);
        next.iter().all(Option::is_some).then(|| next.map(Option::unwrap_or_default))
    })
}
