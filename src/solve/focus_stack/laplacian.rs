//! How sharp a frame is at each pixel.

use crate::solve::resample::in_rows;

/// The squared Laplacian at each pixel; border pixels go on beyond the border.
pub(super) fn squared_laplacian(values: &[f32], [width, height]: [usize; 2]) -> Vec<f32> {
    let mut squares = vec![0.0; values.len()];
    in_rows(&mut squares, width, |y, squares| {
        let row = |y: usize| &values[y.min(height - 1) * width..][..width];
        let (above, own, below) = (row(y.saturating_sub(1)), row(y), row(y + 1));
        for x in 0..width {
            let beside = own[x.saturating_sub(1)] + own[(x + 1).min(width - 1)];
            let laplacian = above[x] + below[x] + beside - 4.0 * own[x];
            squares[x] = laplacian * laplacian;
        }
    });
    squares
}
