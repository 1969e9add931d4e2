//! Windows of both photographs, compared on the host after a solve: how much of the gradients that T was found from is
//! the scene, and whether the photographs differ in blur. Section 5 of `docs/method.md`.

use nalgebra::DMatrix;

use super::channels::{CHANGES, ChannelSums};
use super::contrast::Contrast;
use super::effects::effects;
use super::filter;
use super::processing::{LEAST_BLUR, Noise, Steps};
use super::stages::spline::{Field, near, read};
use super::stages::sums::{UNKNOWNS, displacements};
use super::stages::{ingest, separable};
use super::vulkan::Buffer;
use crate::base::color::LUMINANCE;
use crate::base::{
    Brightness, Channels, Decode, Depth, Error, Format, Frame, Homography, Parallax, Region, Samples, centre, workers,
};

/// The side of a window, px, and about the most windows: 20,000 pixels represent the picture.
const SIDE: u32 = 32;
const MOST: f64 = 20.0;
/// What a smoothed gradient needs around a window, σ of the smoothing: three, and the difference.
const MARGIN: f64 = 4.0;
/// σ of the smoothing, px. It leaves a thirtieth of the power of white noise.
pub(super) const SMOOTHING: f64 = 1.5;
/// The largest |V|, px², at which photographs are compared as they are: beyond it they differ in blur.
const NEARLY_ALIKE: f64 = 1.0;
/// The luminances of integers up to which, and from which on, a pixel counts as clipped.
const CLIPPED: [f64; 2] = [0.0, 0.995];
/// The reach of the spline's prefilter and of the spline, px.
const SPLINE: f64 = 11.0;
/// The least step of σ, px, between blurred images that are interpolated by V; a third of σ if that is more.
const STEP: f64 = 0.7;
/// σ below which an image counts as not blurred, px.
const SHARP: f64 = 0.05;

/// The bytes of a photograph.
#[derive(Clone, Copy)]
pub(super) enum Bytes<'a> {
    Mapped(&'a Buffer),
    Slice(&'a [u8]),
}

/// A photograph in mapped memory or in memory of the host.
pub(super) struct Photograph<'a> {
    pub(super) bytes: Bytes<'a>,
    pub(super) format: Format,
    pub(super) size: [u32; 2],
    pub(super) decode: Decode,
}

impl Photograph<'_> {
    fn luminance(&self, region: Region) -> Result<Field, Error> {
        // The weights of grey pictures are not read.
        self.sum(region, if self.format.channels == Channels::Gray { [1.0, 0.0, 0.0] } else { LUMINANCE })
    }

    /// The weighted sum of the channels.
    fn sum(&self, region: Region, weights: [f32; 3]) -> Result<Field, Error> {
        let Format { channels, depth } = self.format;
        let count = (region.width * channels.count()) as usize;
        let row = |y: u32| {
            let first = u64::from(y) * u64::from(self.size[0]) + u64::from(region.x);
            (first * u64::from(channels.count() * depth.bytes())) as usize
        };
        let rows = region.y..region.y + region.height;
        let samples = match depth {
            Depth::U8 => Samples::U8(self.rows(rows.map(row), count)?),
            Depth::U16 => Samples::U16(self.rows(rows.map(row), count)?),
            Depth::F32 => Samples::F32(self.rows(rows.map(row), count)?),
        };
        let frame = Frame::new(region.width, region.height, channels, samples).map_err(Error::Mismatch)?;
        Ok(ingest::cpu_reference(&frame, self.decode, weights))
    }

    fn rows<T: bytemuck::Pod>(&self, rows: impl Iterator<Item = usize>, count: usize) -> Result<Vec<T>, Error> {
        let row = |first: usize| match self.bytes {
            Bytes::Mapped(buffer) => buffer.read(first, count),
            Bytes::Slice(bytes) => Ok(bytemuck::pod_collect_to_vec(&bytes[first..][..count * size_of::<T>()])),
        };
        let rows: Result<Vec<Vec<T>>, Error> = rows.map(row).collect();
        Ok(rows?.concat())
    }
}

/// A solved pair.
pub(super) struct Pair<'a> {
    pub(super) photographs: [Photograph<'a>; 2],
    pub(super) transform: Homography,
    /// What T maps is displaced by it.
    pub(super) parallax: Parallax,
    pub(super) brightness: Brightness,
    /// V; NaN where it is not valid.
    pub(super) relative_blur: &'a [f32],
    /// The unit of places, px.
    pub(super) length: f64,
    /// σ of the smoothing, px.
    pub(super) smoothing: f64,
}

/// The products of the gradients along the displacements by the unknowns of [`sums`](super::stages::sums).
///
/// Noise of the two photographs is independent, so that `both` has none on average, while `own` contains it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Agreement {
    /// Of a photograph with itself. Upper triangle.
    pub(crate) own: Products,
    /// Of one photograph with the other. Upper triangle.
    pub(crate) both: Products,
}

pub(crate) type Products = [[f64; UNKNOWNS]; UNKNOWNS];

/// Whose products are `own`.
#[derive(Clone, Copy)]
enum Own {
    Second,
    /// The mean of both.
    Mean,
}

impl Agreement {
    const NONE: Self = Self { own: [[0.0; UNKNOWNS]; UNKNOWNS], both: [[0.0; UNKNOWNS]; UNKNOWNS] };

    fn add(&mut self, other: &Self) {
        add_sums(&mut self.own, &other.own);
        add_sums(&mut self.both, &other.both);
    }

    /// What both photographs share of the products along the first `count` unknowns: L⁻¹ `both` L⁻ᵀ, with `own` L Lᵀ.
    /// The identity without noise, 0 where there is only noise. With L⁻ᵀ. `None` without gradients along an unknown.
    pub(crate) fn shared(&self, count: usize) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let matrix = |m: &Products| DMatrix::from_fn(count, count, |i, j| m[i.min(j)][i.max(j)]);
        let inverse = matrix(&self.own).cholesky()?.l().try_inverse()?;
        let shared = &inverse * matrix(&self.both) * inverse.transpose();
        shared.iter().all(|v| v.is_finite()).then(|| (shared, inverse.transpose()))
    }

    /// Adds the gradients of I1 and I2 at a place.
    fn add_pixel(&mut self, gradients: [[f64; 2]; 2], place: [f64; 2], source: Own) {
        let by = displacements(place);
        let [first, second] = gradients.map(|g| by.map(|by| by[0] * g[0] + by[1] * g[1]));
        add_products(&mut self.both, first, second);
        for i in 0..UNKNOWNS {
            for j in i..UNKNOWNS {
                let own = second[i] * second[j];
                self.own[i][j] += match source {
                    Own::Mean => 0.5 * (own + first[i] * first[j]),
                    Own::Second => own,
                };
            }
        }
    }
}

/// Adds the products of the numbers of both photographs.
fn add_products(sum: &mut Products, first: [f64; UNKNOWNS], second: [f64; UNKNOWNS]) {
    for i in 0..UNKNOWNS {
        for j in i..UNKNOWNS {
            sum[i][j] += 0.5 * (first[i] * second[j] + second[i] * first[j]);
        }
    }
}

fn add_sums(sum: &mut Products, other: &Products) {
    sum.iter_mut().flatten().zip(other.iter().flatten()).for_each(|(sum, v)| *sum += v);
}

/// The gradients of a pair.
pub(crate) struct Gradients {
    /// Of the sides of the residual: I1, and I2 on its pixels, the sharper of both blurred by V.
    pub(crate) sharp: Agreement,
    /// Of these smoothed, so that noise is less.
    pub(crate) smooth: Agreement,
    /// The products of the [`effects`] on the smoothed sides, of one side with the other.
    pub(crate) effects: Products,
    /// The contrasts of the smoothed sides in each window.
    pub(crate) matched: Vec<Contrast>,
    /// The contrasts in each window of the photographs without blur by V, I2 on the pixels of I1, smoothed. `None` if
    /// V is not near 0 in all windows.
    pub(crate) unmatched: Option<Vec<Contrast>>,
    /// The change of each photograph from pixel to pixel.
    pub(crate) steps: [Steps; 2],
    /// The noise of each photograph in each window, where it is the softer of the two.
    pub(crate) noise: [Vec<Noise>; 2],
    /// What the channels of each window lack of V; empty if a photograph is grey.
    pub(crate) channels: Vec<ChannelSums>,
}

impl Gradients {
    fn none() -> Self {
        let effects = [[0.0; UNKNOWNS]; UNKNOWNS];
        Self {
            sharp: Agreement::NONE,
            smooth: Agreement::NONE,
            effects,
            matched: Vec::new(),
            unmatched: Some(Vec::new()),
            steps: [Steps::default(); 2],
            noise: [Vec::new(), Vec::new()],
            channels: Vec::new(),
        }
    }

    fn add(&mut self, other: Self) {
        self.sharp.add(&other.sharp);
        self.smooth.add(&other.smooth);
        add_sums(&mut self.effects, &other.effects);
        self.matched.extend(other.matched);
        self.steps.iter_mut().zip(&other.steps).for_each(|(sum, other)| sum.add(other));
        self.noise.iter_mut().zip(other.noise).for_each(|(all, other)| all.extend(other));
        self.channels.extend(other.channels);
        self.unmatched = self.unmatched.take().zip(other.unmatched).map(|(sum, other)| [sum, other].concat());
    }
}

impl Pair<'_> {
    /// The gradients over windows that are spread evenly over the picture.
    pub(super) fn gradients(&self) -> Result<Gradients, Error> {
        let windows = self.windows();
        let one = |n: usize| self.window(windows[n]);
        let mut sum = Gradients::none();
        for window in workers::map(windows.len(), one) {
            if let Some(window) = window? {
                sum.add(window);
            }
        }
        Ok(sum)
    }

    fn size(&self) -> [u32; 2] {
        self.photographs[0].size
    }

    fn windows(&self) -> Vec<Region> {
        let size = self.size();
        let ratio = (f64::from(size[0]) / f64::from(size[1])).sqrt();
        let most = [MOST.sqrt() * ratio, MOST.sqrt() / ratio];
        let counts = [0, 1].map(|n| (size[n] / SIDE).min(most[n] as u32).max(1));
        let side = size.map(|side| side.min(SIDE));
        let first = |n: usize, i: u32| ((2 * i + 1) * size[n] / (2 * counts[n])).saturating_sub(side[n] / 2);
        let row = |j| (0..counts[0]).map(move |i| (i, j));
        let place = |(i, j)| Region { x: first(0, i), y: first(1, j), width: side[0], height: side[1] };
        (0..counts[1]).flat_map(row).map(place).collect()
    }

    /// The parallax of a place of I1, by V of the nearest pixel, px.
    fn parallax_at(&self, place: [f64; 2], whole: [f64; 2]) -> [f64; 2] {
        let [x, y] = [0, 1].map(|n| place[n].round().clamp(0.0, f64::from(self.size()[n] - 1)) as u32);
        let v = self.v(x, y);
        self.parallax.displacement([place[0] - whole[0], place[1] - whole[1]], if v.is_nan() { 0.0 } else { v })
    }

    fn v(&self, x: u32, y: u32) -> f64 {
        self.relative_blur[y as usize * self.size()[0] as usize + x as usize].into()
    }

    /// The gradients on every other pixel of a window; `None` if V is valid on none.
    fn window(&self, window: Region) -> Result<Option<Gradients>, Error> {
        let columns = move |y| (window.x + (y & 1)..window.x + window.width).step_by(2).map(move |x| (x, y));
        let pixels = (window.y..window.y + window.height).flat_map(columns);
        let valid: Vec<(u32, u32)> = pixels.filter(|&(x, y)| self.v(x, y).is_finite()).collect();
        let Some(widest) = valid.iter().map(|&(x, y)| self.v(x, y).abs()).reduce(f64::max) else { return Ok(None) };
        let reach = (MARGIN * self.smoothing + 3.0 * widest.sqrt()).ceil() as u32;
        let part = window.expanded(reach, self.size());
        let i1 = self.photographs[0].luminance(part)?;
        let Some(counterpart) = self.counterpart(part) else { return Ok(None) };
        let original = self.photographs[1].luminance(counterpart)?;
        let steps = [Steps::of(&i1, [part.x, part.y]), Steps::of(&original, [counterpart.x, counterpart.y])];
        let photographs = [i1, self.registered(part, &original, counterpart)];
        let clear = self.clear(part, &photographs, reach as usize);
        let alike =
            (widest <= NEARLY_ALIKE).then(|| photographs.each_ref().map(|i| separable::smoothed(i, self.smoothing)));
        let sides = self.sides(part, &photographs, widest);
        let smooth = sides.each_ref().map(|side| separable::smoothed(side, self.smoothing));
        let channels = self.channels(part, counterpart, widest, &smooth)?;
        let splines = sides.each_ref().map(spline);
        let whole = centre(self.size()[0], self.size()[1]);
        let (mut sums, mut matched, mut unmatched) = (Gradients::none(), Contrast::default(), Contrast::default());
        let mut by_channel = ChannelSums::default();
        for (x, y) in valid {
            let place = [(f64::from(x) - whole[0]) / self.length, (f64::from(y) - whole[1]) / self.length];
            let (x, y) = ((x - part.x) as usize, (y - part.y) as usize);
            let sharp = splines.each_ref().map(|spline| {
                let jet = near(spline, x, y);
                [jet.dx, jet.dy]
            });
            sums.sharp.add_pixel(sharp, place, Own::Second);
            let (x, y) = (x as isize, y as isize);
            let gradients = smooth.each_ref().map(|side| difference(side, x, y));
            sums.smooth.add_pixel(gradients, place, Own::Mean);
            if !clear(x as usize, y as usize) {
                continue;
            }
            matched.add_gradients(gradients);
            let at = |side: &Field| effects(side.clamped(x, y), laplacian(side, x, y), place);
            let [first, second] = smooth.each_ref().map(at);
            add_products(&mut sums.effects, first, second);
            if let Some(channels) = &channels {
                let of = channels.each_ref().map(|[mean, difference]| (changes(mean, x, y), difference.clamped(x, y)));
                by_channel.add_pixel(of.map(|(changes, _)| changes), of.map(|(_, difference)| difference));
            }
            if let Some(alike) = &alike {
                unmatched.add_gradients(alike.each_ref().map(|image| difference(image, x, y)));
                unmatched.add_laplacians(alike.each_ref().map(|image| laplacian(image, x, y)));
            }
        }
        sums.channels.extend(channels.map(|_| by_channel));
        (sums.matched, sums.unmatched, sums.steps) = (vec![matched], alike.map(|_| vec![unmatched]), steps);
        // On the pixels of each photograph: an interpolation would change its noise.
        let on_i1 = Field::from_fn(sides[0].width, sides[0].height, |x, y| sides[0].get(x, y) - sides[1].get(x, y));
        let (on_i2, place) = self.difference_on_i2(part, &splines[0], &original, counterpart);
        let is_softer = |place: Option<[usize; 2]>, sign: f64| {
            place.is_some_and(|[x, y]| {
                let [column, row] = [part.x + x as u32, part.y + y as u32];
                let is_inside = (window.x..window.x + window.width).contains(&column)
                    && (window.y..window.y + window.height).contains(&row);
                is_inside && sign * self.v(column, row) > LEAST_BLUR && clear(x, y)
            })
        };
        sums.noise = [
            vec![Noise::of(&on_i1, |x, y| is_softer(Some([x, y]), -1.0))],
            vec![Noise::of(&on_i2, |x, y| is_softer(place(x, y), 1.0))],
        ];
        Ok(Some(sums))
    }

    /// I1, and I2 on its pixels, the sharper of both blurred by V, at most by `widest`.
    fn sides(&self, part: Region, [first, second]: &[Field; 2], widest: f64) -> [Field; 2] {
        [(first, 1.0), (second, -1.0)].map(|(image, sign)| {
            // No blur where V is not valid: such places are around the window.
            let v = |x: usize, y: usize| (sign * self.v(part.x + x as u32, part.y + y as u32)).clamp(0.0, widest);
            let v = |x, y| Some(v(x, y)).filter(|v| v.is_finite()).unwrap_or(0.0);
            blurred(image, &Field::from_fn(image.width, image.height, v))
        })
    }

    /// The mean and the difference of both smoothed sides, by red, green and blue; `None` if a photograph is grey.
    /// `luminance` has the smoothed sides of their sum, from which green follows.
    fn channels(
        &self,
        part: Region,
        counterpart: Region,
        widest: f64,
        luminance: &[Field; 2],
    ) -> Result<Option<[[Field; 2]; 3]>, Error> {
        if self.photographs.iter().any(|photograph| photograph.format.channels == Channels::Gray) {
            return Ok(None);
        }
        let smooth = |weights: [f32; 3]| {
            let original = self.photographs[1].sum(counterpart, weights)?;
            let photographs = [self.photographs[0].sum(part, weights)?, self.registered(part, &original, counterpart)];
            Ok(self.sides(part, &photographs, widest).map(|side| separable::smoothed(&side, self.smoothing)))
        };
        let [red, blue] = [smooth([1.0, 0.0, 0.0])?, smooth([0.0, 0.0, 1.0])?];
        let [of_red, of_green, of_blue] = LUMINANCE.map(f64::from);
        let green = [0, 1].map(|n| {
            let value =
                |x, y| (luminance[n].get(x, y) - of_red * red[n].get(x, y) - of_blue * blue[n].get(x, y)) / of_green;
            Field::from_fn(red[n].width, red[n].height, value)
        });
        Ok(Some([red, green, blue].map(|[first, second]| {
            let of = |share: f64, sign: f64| {
                let value = |x, y| share * (first.get(x, y) + sign * second.get(x, y));
                Field::from_fn(first.width, first.height, value)
            };
            [of(0.5, 1.0), of(1.0, -1.0)]
        })))
    }

    /// The difference between I1's side of a part, from its spline, and I2, on the pixels of I2's `counterpart` and in
    /// the brightness of I1; and the pixel of the part that is nearest to a pixel of the counterpart.
    fn difference_on_i2(
        &self,
        part: Region,
        side: &Field,
        original: &Field,
        counterpart: Region,
    ) -> (Field, impl Fn(usize, usize) -> Option<[usize; 2]>) {
        let (whole, inverse) = (centre(self.size()[0], self.size()[1]), self.transform.inverse());
        let place =
            move |x: usize, y: usize| [f64::from(counterpart.x) + x as f64, f64::from(counterpart.y) + y as f64];
        let on_part = move |x: usize, y: usize| {
            let [x, y] = inverse.apply(place(x, y), whole);
            // V hardly changes over the parallax.
            let [dx, dy] = self.parallax_at([x, y], whole);
            let [dx, dy] = self.parallax_at([x - dx, y - dy], whole);
            [x - dx - f64::from(part.x), y - dy - f64::from(part.y)]
        };
        let difference = |x: usize, y: usize| {
            let [at_x, at_y] = on_part(x, y);
            read(side, at_x, at_y).value - self.brightness.apply(original.get(x, y), place(x, y))
        };
        let nearest = move |x: usize, y: usize| {
            let [x, y] = on_part(x, y).map(f64::round);
            let is_inside = x >= 0.0 && y >= 0.0 && x < f64::from(part.width) && y < f64::from(part.height);
            is_inside.then_some([x as usize, y as usize])
        };
        (Field::from_fn(original.width, original.height, difference), nearest)
    }

    /// A test of whether no pixel up to `reach` px from a place of a part is clipped, masked or without V: around such
    /// pixels the two photographs do not show the same light.
    fn clear(&self, part: Region, photographs: &[Field; 2], reach: usize) -> impl Fn(usize, usize) -> bool {
        let [width, height] = [part.width, part.height].map(|v| v as usize);
        let can_clip = self.photographs.each_ref().map(|photograph| photograph.format.depth != Depth::F32);
        let is_bad = |x: usize, y: usize| {
            let [column, row] = [part.x + x as u32, part.y + y as u32];
            let place = [column, row].map(f64::from);
            let levels = CLIPPED.map(|level| [level, self.brightness.apply(level, place)]);
            let clips = |n: usize| {
                let value = photographs[n].get(x, y);
                can_clip[n] && (value <= levels[0][n] || value >= levels[1][n])
            };
            self.v(column, row).is_nan() || clips(0) || clips(1)
        };
        // Sums over all pixels above and to the left.
        let mut sums = vec![0u32; (width + 1) * (height + 1)];
        let at = move |x: usize, y: usize| y * (width + 1) + x;
        for y in 0..height {
            for x in 0..width {
                let beside = sums[at(x, y + 1)] + sums[at(x + 1, y)] - sums[at(x, y)];
                sums[at(x + 1, y + 1)] = beside + u32::from(is_bad(x, y));
            }
        }
        move |x, y| {
            let [left, top] = [x, y].map(|v| v.saturating_sub(reach));
            let [right, bottom] = [(x + reach + 1).min(width), (y + reach + 1).min(height)];
            sums[at(right, bottom)] + sums[at(left, top)] == sums[at(left, bottom)] + sums[at(right, top)]
        }
    }

    /// The part of I2 that its spline reads on the pixels of a part of I1. `None` if T maps the part outside of I2.
    fn counterpart(&self, part: Region) -> Option<Region> {
        let (size, whole) = (self.photographs[1].size, centre(self.size()[0], self.size()[1]));
        let ends = |first: u32, length: u32| [f64::from(first), f64::from(first + length - 1)];
        let [left, top] = [ends(part.x, part.width), ends(part.y, part.height)];
        let corners = left.into_iter().flat_map(|x| top.map(|y| [x, y]));
        let rows = (part.y..part.y + part.height).flat_map(|y| (part.x..part.x + part.width).map(move |x| (x, y)));
        let values = rows.map(|(x, y)| self.v(x, y)).filter(|v| self.parallax != Parallax::NONE && v.is_finite());
        let [least, most] = values.fold([0.0f64; 2], |[least, most], v| [least.min(v), most.max(v)]);
        let displaced = |corner: [f64; 2]| {
            [least, most].map(|v| {
                let d = self.parallax.displacement([corner[0] - whole[0], corner[1] - whole[1]], v);
                self.transform.apply([corner[0] + d[0], corner[1] + d[1]], whole)
            })
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in corners.flat_map(displaced) {
            for n in 0..2 {
                (low[n], high[n]) = (low[n].min(corner[n]), high[n].max(corner[n]));
            }
        }
        let first = [0, 1].map(|n| (low[n] - SPLINE).floor().max(0.0));
        let end = [0, 1].map(|n| (high[n] + SPLINE).ceil().min(f64::from(size[n])));
        if !(0..2).all(|n| end[n] - first[n] >= 2.0 * SPLINE && low[n].is_finite() && high[n].is_finite()) {
            return None;
        }
        let [x, y, width, height] = [first[0], first[1], end[0] - first[0], end[1] - first[1]].map(|v| v as u32);
        Some(Region { x, y, width, height })
    }

    /// I2 on the pixels of a part of I1, in the brightness of I1; from the [`counterpart`](Self::counterpart) in I2.
    fn registered(&self, part: Region, original: &Field, counterpart: Region) -> Field {
        let (whole, first) = (centre(self.size()[0], self.size()[1]), [counterpart.x, counterpart.y].map(f64::from));
        let coefficients = spline(original);
        let value = |i: usize, j: usize| {
            let place = [f64::from(part.x) + i as f64, f64::from(part.y) + j as f64];
            let [dx, dy] = self.parallax_at(place, whole);
            let place = self.transform.apply([place[0] + dx, place[1] + dy], whole);
            let value = read(&coefficients, place[0] - first[0], place[1] - first[1]).value;
            self.brightness.apply(value, place)
        };
        Field::from_fn(part.width as usize, part.height as usize, value)
    }
}

/// Spline coefficients.
fn spline(image: &Field) -> Field {
    let prefilter = filter::spline_prefilter();
    separable::filtered(image, [&prefilter; 2], 1)
}

/// The central difference at a pixel.
fn difference(image: &Field, x: isize, y: isize) -> [f64; 2] {
    [
        0.5 * (image.clamped(x + 1, y) - image.clamped(x - 1, y)),
        0.5 * (image.clamped(x, y + 1) - image.clamped(x, y - 1)),
    ]
}

/// What changes a channel at a pixel.
fn changes(image: &Field, x: isize, y: isize) -> [f64; CHANGES] {
    let [dx, dy] = difference(image, x, y);
    [0.5 * laplacian(image, x, y), dx, dy, image.clamped(x, y), 1.0]
}

fn laplacian(image: &Field, x: isize, y: isize) -> f64 {
    let near = [[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]].map(|[x, y]| image.clamped(x, y));
    near.iter().sum::<f64>() - 4.0 * image.clamped(x, y)
}

/// The image under a Gaussian whose variance is stated at each pixel.
fn blurred(image: &Field, variance: &Field) -> Field {
    let sigmas = variance.data.iter().map(|v| v.sqrt());
    let [least, most] = sigmas.fold([f64::INFINITY, 0.0], |[least, most], s| [least.min(s), most.max(s)]);
    if most < SHARP {
        return image.clone();
    }
    let mut sigmas = vec![least];
    while let Some(&last) = sigmas.last().filter(|&&last| last < most) {
        sigmas.push((last + STEP.max(last / 3.0)).min(most));
    }
    let node = |&sigma: &f64| if sigma < SHARP { image.clone() } else { separable::smoothed(image, sigma) };
    let nodes: Vec<Field> = sigmas.iter().map(node).collect();
    let value = |x: usize, y: usize| {
        let v = variance.get(x, y);
        let n = sigmas.partition_point(|sigma| sigma * sigma < v).clamp(1, (nodes.len() - 1).max(1));
        let Some(high) = nodes.get(n) else { return nodes[0].get(x, y) };
        let [least, most] = [n - 1, n].map(|n| sigmas[n] * sigmas[n]);
        let share = ((v - least) / (most - least)).clamp(0.0, 1.0);
        (1.0 - share) * nodes[n - 1].get(x, y) + share * high.get(x, y)
    };
    Field::from_fn(image.width, image.height, value)
}
