//! Which of the reference's pixels a frame shows.

use crate::base::Homography;
use crate::engine::plan::Level;

/// Left, top, right and bottom of a rectangle, pixels of a level.
pub(super) type Rectangle = [f64; 4];

/// The rectangle of the reference's pixels within what a frame shows of them: T puts little more than that into it where frames turn by
/// less than a degree.
pub(super) fn by(t: &Homography, level: &Level) -> Rectangle {
    let last = level.size.map(|side| f64::from(side) - 1.0);
    let inverse = t.inverse();
    let corner = |x: f64, y: f64| {
        let d = inverse.displacement([level.factor * (x - level.centre[0]), level.factor * (y - level.centre[1])]);
        [x + d[0] / level.factor, y + d[1] / level.factor]
    };
    let [a, b, c, d] = [corner(0.0, 0.0), corner(last[0], 0.0), corner(0.0, last[1]), corner(last[0], last[1])];
    let inside = [a[0].max(c[0]), a[1].max(b[1]), b[0].min(d[0]), c[1].min(d[1])];
    by_both([inside, [0.0, 0.0, last[0], last[1]]])
}

/// What is in both.
pub(super) fn by_both([a, b]: [Rectangle; 2]) -> Rectangle {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Similarity;

    #[test]
    fn a_frame_that_lies_aside_shows_the_rest() {
        let level = Level::new(1, 101, 81, 10.0);
        let t = Homography::from(Similarity { scale: 1.0, rotation: 0.0, tx: 6.0, ty: -4.0 });
        // Pixel x of the reference lies at x + 3, y - 2 of the level's.
        assert_eq!(by(&t, &level).map(|side| side.round()), [0.0, 2.0, 47.0, 40.0]);
        let turned = Homography::from(Similarity { scale: 1.0, rotation: 0.1, tx: 0.0, ty: 0.0 });
        let [left, top, right, bottom] = by(&turned, &level);
        for (x, y) in [(left, top), (right, top), (left, bottom), (right, bottom)] {
            let at = [level.factor * (x - level.centre[0]), level.factor * (y - level.centre[1])];
            let d = turned.displacement(at);
            let place = [x + d[0] / level.factor, y + d[1] / level.factor];
            assert!((0..2).all(|n| place[n] > -1e-9 && place[n] < f64::from(level.size[n]) - 1.0 + 1e-9), "{place:?}");
        }
    }
}
