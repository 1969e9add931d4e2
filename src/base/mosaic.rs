//! Colours of a sensor behind a Bayer mosaic, by linear filters of 5x5 that follow the luminance of the colour at hand: Malvar, He and Cutler,
//! High-quality linear interpolation for demosaicing of Bayer-patterned color images, ICASSP 2004.

/// Where red is among two by two pixels, blue diagonally from it, green in the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Mosaic(pub(crate) [u32; 2]);

/// A colour, 0 red, 1 green, 2 blue, of a pixel from the samples of a mosaic, each 0 to `most`: beyond the border they are
/// mirrored at its pixels, which keeps the mosaic as it is.
pub(crate) fn color(
    Mosaic(red): Mosaic,
    channel: usize,
    [x, y]: [usize; 2],
    size: [usize; 2],
    most: i64,
    sample: impl Fn(usize, usize) -> i64,
) -> u32 {
    let inside = |p: i64, side: usize| p.abs().min(2 * (side as i64 - 1) - p.abs()).max(0) as usize;
    let at = |dx: i64, dy: i64| sample(inside(x as i64 + dx, size[0]), inside(y as i64 + dy, size[1]));
    let across = |d: i64| at(-d, 0) + at(d, 0);
    let along = |d: i64| at(0, -d) + at(0, d);
    let (here, corners) = (at(0, 0), || at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1));
    // Red's rows, and its columns.
    let [in_column, in_row] = [(x as u32 & 1) == red[0], (y as u32 & 1) == red[1]];
    let is_green = in_column != in_row;
    // In sixteenths.
    let sum = match channel {
        1 if is_green => 16 * here,
        1 => 8 * here + 4 * (across(1) + along(1)) - 2 * (across(2) + along(2)),
        // Green between two of the colour in its row, or in its column.
        c if is_green && in_row == (c == 0) => 10 * here + 8 * across(1) - 2 * corners() - 2 * across(2) + along(2),
        _ if is_green => 10 * here + 8 * along(1) - 2 * corners() - 2 * along(2) + across(2),
        c if in_row == (c == 0) => 16 * here,
        _ => 12 * here + 4 * corners() - 3 * (across(2) + along(2)),
    };
    ((sum + 8) >> 4).clamp(0, most) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [9, 7];

    fn each(mut check: impl FnMut(Mosaic, [usize; 2], usize)) {
        for mosaic in [[0, 0], [1, 0], [0, 1], [1, 1]].map(Mosaic) {
            for (x, y, c) in (0..SIZE[0] * SIZE[1] * 3).map(|i| (i / 3 % SIZE[0], i / 3 / SIZE[0], i % 3)) {
                check(mosaic, [x, y], c);
            }
        }
    }

    /// What a sensor has of colours that are the same everywhere.
    fn of(Mosaic(red): Mosaic, colors: [i64; 3], [x, y]: [usize; 2]) -> i64 {
        let [in_column, in_row] = [(x as u32 & 1) == red[0], (y as u32 & 1) == red[1]];
        colors[if in_column != in_row {
            1
        } else if in_row {
            0
        } else {
            2
        }]
    }

    #[test]
    fn one_colour_is_found_exactly_up_to_the_border() {
        let colors = [200, 90, 3];
        each(|mosaic, place, c| {
            let found = color(mosaic, c, place, SIZE, 255, |x, y| of(mosaic, colors, [x, y]));
            assert_eq!(i64::from(found), colors[c], "{mosaic:?} {place:?} {c}");
        });
    }

    #[test]
    fn a_grey_slope_is_found_exactly_within() {
        each(|mosaic, [x, y], c| {
            if (2..SIZE[0] - 2).contains(&x) && (2..SIZE[1] - 2).contains(&y) {
                let found = color(mosaic, c, [x, y], SIZE, 65535, |x, y| 100 + 7 * x as i64 + 13 * y as i64);
                assert_eq!(found as usize, 100 + 7 * x + 13 * y);
            }
        });
    }

    #[test]
    fn what_overshoots_is_clamped() {
        each(|mosaic, place, c| {
            let found = color(mosaic, c, place, SIZE, 255, |x, y| if (x / 2 + y / 3) % 2 == 0 { 255 } else { 0 });
            assert!(found <= 255);
        });
    }
}
