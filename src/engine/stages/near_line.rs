//! Both images along a line of pixels, on a level where I2 is warped onto I1's pixels.
//!
//! The same as [`blur::read_near`](super::blur::read_near) at each pixel, with each node's jets computed for the whole
//! line: contiguous loads, a few nodes per line.

use std::ops::Range;

use super::blur::{PairSample, Stacks, sample_jets};
use super::lanes::vectorised;
use super::spline::{Jet, mirror};
use super::stack::node_below;
use super::{Number, Raster};

/// The jets of a node along a line.
#[derive(Default)]
struct JetRow<N> {
    value: Vec<N>,
    dx: Vec<N>,
    dy: Vec<N>,
    laplacian: Vec<N>,
    /// Along y of each column, of one column more on either side: value, slope and bend.
    columns: [Vec<N>; 3],
}

impl<N: Number> JetRow<N> {
    #[inline(always)]
    fn load(&mut self, coefficients: &Raster<N>, y: usize, xs: Range<usize>) {
        let (width, height) = (coefficients.width, coefficients.height);
        let [above, here, below] = [-1, 0, 1].map(|n| coefficients.row(mirror(y as isize + n, height)));
        let [four, half, sixth] = [4.0, 0.5, 1.0 / 6.0].map(N::of);
        let column = |x: usize| {
            let (a, h, b) = (above[x], here[x], below[x]);
            [sixth * (a + four * h + b), half * (b - a), a - h - h + b]
        };
        let (count, outside) = (xs.len(), [xs.start as isize - 1, xs.end as isize].map(|x| column(mirror(x, width))));
        for (n, column) in self.columns.iter_mut().enumerate() {
            column.resize(count + 2, N::default());
            (column[0], column[count + 1]) = (outside[0][n], outside[1][n]);
        }
        let (above, here, below) = (&above[xs.clone()][..count], &here[xs.clone()][..count], &below[xs][..count]);
        let [values, slopes, bends] = &mut self.columns;
        let (v, s, b) = (&mut values[1..][..count], &mut slopes[1..][..count], &mut bends[1..][..count]);
        for x in 0..count {
            v[x] = sixth * (above[x] + four * here[x] + below[x]);
            s[x] = half * (below[x] - above[x]);
            b[x] = above[x] - here[x] - here[x] + below[x];
        }
        for row in [&mut self.value, &mut self.dx, &mut self.dy, &mut self.laplacian] {
            row.resize(count, N::default());
        }
        let (value, dx) = (&mut self.value[..count], &mut self.dx[..count]);
        let (dy, laplacian) = (&mut self.dy[..count], &mut self.laplacian[..count]);
        let (v0, v1, v2) = (&values[..count], &values[1..][..count], &values[2..][..count]);
        for x in 0..count {
            value[x] = sixth * (v0[x] + four * v1[x] + v2[x]);
            dx[x] = half * (v2[x] - v0[x]);
            laplacian[x] = v0[x] - v1[x] - v1[x] + v2[x];
        }
        let (s0, s1, s2) = (&slopes[..count], &slopes[1..][..count], &slopes[2..][..count]);
        let (b0, b1, b2) = (&bends[..count], &bends[1..][..count], &bends[2..][..count]);
        for x in 0..count {
            dy[x] = sixth * (s0[x] + four * s1[x] + s2[x]);
            laplacian[x] += sixth * (b0[x] + four * b1[x] + b2[x]);
        }
    }

    #[inline(always)]
    fn at(&self, x: usize) -> Jet<N> {
        Jet { value: self.value[x], dx: self.dx[x], dy: self.dy[x], laplacian: self.laplacian[x] }
    }
}

/// The nodes of both stacks that the pixels of a line are read from.
#[derive(Default)]
pub(super) struct NearLine<N> {
    first_pixel: usize,
    /// By node.
    stacks: [Vec<JetRow<N>>; 2],
}

impl<N: Number> NearLine<N> {
    /// Loads the nodes about the V of all pixels of a line. Others keep what they held.
    pub(super) fn load(&mut self, stacks: &Stacks<N>, v: &Raster<N>, y: usize, xs: Range<usize>) {
        self.first_pixel = xs.start;
        let least_and_most = |values: &mut dyn Iterator<Item = f64>| {
            values.fold(None, |range: Option<[f64; 2]>, v| {
                Some(range.map_or([v, v], |[least, most]| [least.min(v), most.max(v)]))
            })
        };
        let row = || v.row(y)[xs.clone()].iter().map(|&v| -> f64 { v.into() });
        let ranges = [
            least_and_most(&mut row().filter(|v| *v >= 0.0)),
            least_and_most(&mut row().filter(|v| *v < 0.0).map(|v| -v)),
        ];
        for ((jets, stack), range) in self.stacks.iter_mut().zip([stacks.first, stacks.second]).zip(ranges) {
            jets.resize_with(stack.len(), JetRow::default);
            let nodes = range.map(|range| range.map(|v| node_below(v, stack.len())));
            for (k, jets) in jets.iter_mut().enumerate() {
                if k == 0 || nodes.is_some_and(|[least, most]| (least..=most + 1).contains(&k)) {
                    vectorised(
                        #[inline(always)]
                        || jets.load(&stack[k], y, xs.clone()),
                    );
                }
            }
        }
    }

    /// Both images at pixel x of the line, which T has moved by `shift` since I2 was warped.
    #[inline(always)]
    pub(super) fn sample(&self, x: usize, v: N, shift: [f64; 2]) -> PairSample<N> {
        let (n, [first, second]) = (x - self.first_pixel, &self.stacks);
        let at = |stack: &[JetRow<N>], k: usize| stack[k].at(n);
        let counts = [first.len(), second.len()];
        sample_jets(
            v,
            shift.map(N::of),
            counts,
            #[inline(always)]
            |k| at(first, k),
            #[inline(always)]
            |k| at(second, k),
        )
    }
}
