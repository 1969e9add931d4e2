//! Form removal (F-operation): plane, quadric or cylinder, fitted by least squares of the heights.

use nalgebra::{SMatrix, SVector};

use super::areal::Surface;
use crate::base::Error;

/// The form that is removed from a surface before its texture is evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "lowercase"))]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Form {
    /// No form: only the mean is subtracted
    None,
    /// A plane
    #[default]
    Plane,
    /// A polynomial of second degree
    Quadric,
    /// A cylinder, convex or concave, whose axis has any direction
    Cylinder,
}

type Matrix = SMatrix<f64, 6, 6>;
type Vector = SVector<f64, 6>;

/// Steps of the fit of a cylinder, and the relative decrease of its squared sum that ends it.
const MAX_STEPS: usize = 200;
const SETTLED: f64 = 1e-13;
/// The least curvature of a cylinder, as its sagitta over half of the longer side in ranges of the heights. A smaller
/// one is rounding.
const LEAST_CURVATURE: f64 = 1e-7;

impl Surface {
    /// Subtracts the form. `pixel` is the size of a pixel in the unit of the heights. If it is not known, a cylinder's
    /// section may be any ellipse, since its two semi-axes have different units.
    ///
    /// # Errors
    /// [`Error::Region`] if the measured pixels do not determine the form.
    pub(super) fn subtract_form(&mut self, form: Form, pixel: Option<f64>) -> Result<(), Error> {
        let grid = Grid::new(self);
        match form {
            Form::None => (),
            Form::Plane => {
                let plane = grid.fit_polynomial(&self.values, 3)?;
                grid.subtract(&mut self.values, |at| polynomial(at).dot(&plane));
            }
            Form::Quadric => {
                let quadric = grid.fit_polynomial(&self.values, 6)?;
                grid.subtract(&mut self.values, |at| polynomial(at).dot(&quadric));
            }
            Form::Cylinder => {
                let cylinder = grid.fit_cylinder(&self.values, pixel)?;
                grid.subtract(&mut self.values, |at| cylinder.height(at));
            }
        }
        Ok(())
    }
}

/// The places of pixels in halves of the longer side from the centre, so that sums have similar magnitudes.
struct Grid {
    width: usize,
    centre: [f64; 2],
    half: f64,
}

impl Grid {
    fn new(surface: &Surface) -> Self {
        let sides = [surface.width, surface.height()].map(|side| side.saturating_sub(1) as f64);
        let half = (sides[0].max(sides[1]) / 2.0).max(0.5);
        Self { width: surface.width, centre: sides.map(|side| side / 2.0), half }
    }

    fn at(&self, i: usize) -> [f64; 2] {
        let place = [(i % self.width) as f64, (i / self.width) as f64];
        [0, 1].map(|n| (place[n] - self.centre[n]) / self.half)
    }

    /// Calls a function with each measured pixel's place and height.
    fn each(&self, values: &[f64], mut function: impl FnMut([f64; 2], f64)) {
        for (i, z) in values.iter().enumerate().filter(|(_, z)| z.is_finite()) {
            function(self.at(i), *z);
        }
    }

    fn subtract(&self, values: &mut [f64], form: impl Fn([f64; 2]) -> f64) {
        for (i, z) in values.iter_mut().enumerate().filter(|(_, z)| z.is_finite()) {
            *z -= form(self.at(i));
        }
    }

    /// Fits the first `terms` terms of a polynomial.
    fn fit_polynomial(&self, values: &[f64], terms: usize) -> Result<Vector, Error> {
        let (mut normal, mut right, mut count) = (Matrix::zeros(), Vector::zeros(), 0.0);
        self.each(values, |at, z| {
            let basis = polynomial(at);
            normal += basis * basis.transpose();
            right += z * basis;
            count += 1.0;
        });
        for n in terms..6 {
            normal.row_mut(n).fill(0.0);
            normal.column_mut(n).fill(0.0);
            (normal[(n, n)], right[n]) = (count, 0.0);
        }
        // Pixels on a line do not determine a plane, nor pixels on two lines a quadric.
        let is_determined = normal.symmetric_eigenvalues().min() > 1e-9 * count;
        let solution = normal.cholesky().map(|cholesky| cholesky.solve(&right));
        solution.filter(|_| is_determined).ok_or_else(|| {
            Error::Region(
                "the measured pixels do not determine the form: give a larger region, or a simpler form".into(),
            )
        })
    }

    /// Fits a cylinder by Levenberg and Marquardt, from the quadric's principal curvatures.
    fn fit_cylinder(&self, values: &[f64], pixel: Option<f64>) -> Result<Cylinder, Error> {
        let quadric = self.fit_polynomial(values, 6)?;
        let (low, high) = values
            .iter()
            .filter(|z| z.is_finite())
            .fold((f64::MAX, f64::MIN), |(low, high), z| (low.min(*z), high.max(*z)));
        // In these units a circle has equal semi-axes.
        let unit = pixel.map_or((high - low).max(f64::MIN_POSITIVE), |pixel| pixel * self.half);
        let no_curvature = || {
            let problem = "the surface has too little curvature for a cylinder: remove a plane or a quadric";
            Error::Region(problem.to_string())
        };
        let start = Cylinder::of_quadric(&(quadric / unit), unit, pixel);
        let is_curved = (start.bend * unit).abs() > LEAST_CURVATURE * (high - low);
        let mut best = start.within(1.5 + start.offset.abs());
        if !is_curved || !best.bend.is_finite() {
            return Err(no_curvature());
        }
        let mut damping = 1e-3;
        let (mut cost, mut normal, mut right) = self.linearise(values, &best);
        for _ in 0..MAX_STEPS {
            let mut damped = normal;
            for n in 0..6 {
                damped[(n, n)] += damping * normal[(n, n)] + 1e-12;
            }
            let Some(step) = damped.cholesky().map(|cholesky| cholesky.solve(&right)) else { break };
            let next = best.moved(&step);
            let (next_cost, next_normal, next_right) = self.linearise(values, &next);
            if next_cost < cost {
                let is_settled = cost - next_cost <= SETTLED * cost;
                (best, cost, normal, right) = (next, next_cost, next_normal, next_right);
                damping = (0.2 * damping).max(1e-12);
                if is_settled {
                    break;
                }
            } else {
                damping *= 5.0;
                if damping > 1e12 {
                    break;
                }
            }
        }
        if cost.is_finite() { Ok(best) } else { Err(no_curvature()) }
    }

    /// Returns the squared sum of residuals, in the cylinder's unit, and the normal equations of a step. The sum is
    /// infinite if a pixel lies beside the cylinder.
    fn linearise(&self, values: &[f64], cylinder: &Cylinder) -> (f64, Matrix, Vector) {
        let (mut cost, mut normal, mut right) = (0.0, Matrix::zeros(), Vector::zeros());
        self.each(values, |at, z| {
            let (height, gradient) = cylinder.height_and_gradient(at);
            let residual = z / cylinder.unit - height;
            cost += if residual.is_finite() { residual * residual } else { f64::INFINITY };
            normal += gradient * gradient.transpose();
            right += residual * gradient;
        });
        (cost, normal, right)
    }
}

/// Returns the terms of a polynomial of second degree.
fn polynomial([x, y]: [f64; 2]) -> Vector {
    Vector::from([1.0, x, y, x * x, x * y, y * y])
}

/// A cylinder: `z = base + tilt e + bend d²/(1 + sqrt(1 - squash d²))`, e along and d across its axis in the image.
///
/// A circle of radius R whose axis rises by the tilt has `bend² = (1 + tilt²)/R²` and `squash = 1/R²`. This form of the
/// section is the sagitta of optics, which has no singularity where the curvature passes through zero.
#[derive(Clone, Copy, Debug)]
struct Cylinder {
    /// Angle of the axis in the image.
    angle: f64,
    /// Distance of the axis from the centre of the image.
    offset: f64,
    tilt: f64,
    base: f64,
    /// Curvature at the vertex; negative if it is convex towards the camera.
    bend: f64,
    /// The inverse square of the semi-axis in the image.
    squash: f64,
    /// Whether the section is a circle.
    is_round: bool,
    /// The unit of heights, in the unit of the surface.
    unit: f64,
}

impl Cylinder {
    /// Returns the cylinder that osculates a quadric: across its axis is the direction of the largest curvature.
    fn of_quadric(quadric: &Vector, unit: f64, pixel: Option<f64>) -> Self {
        let [base, x, y, xx, xy, yy] = [0, 1, 2, 3, 4, 5].map(|n| quadric[n]);
        // Principal curvatures are the mean ± the difference; the axis is the direction of the smaller one.
        let (mean, difference) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy / 2.0));
        let steepest = 0.5 * xy.atan2(xx - yy);
        let (curvature, angle) = match mean >= 0.0 {
            true => (mean + difference, steepest + std::f64::consts::FRAC_PI_2),
            false => (mean - difference, steepest),
        };
        let (sin, cos) = angle.sin_cos();
        let (along, across) = (x * cos + y * sin, y * cos - x * sin);
        let offset = -across / (2.0 * curvature);
        let base = base - curvature * offset * offset;
        let is_round = pixel.is_some();
        Self { angle, offset, tilt: along, base, bend: 2.0 * curvature, squash: 0.0, is_round, unit }.tied()
    }

    /// Sets the squash of a circle.
    fn tied(mut self) -> Self {
        if self.is_round {
            self.squash = self.bend * self.bend / (1.0 + self.tilt * self.tilt);
        }
        self.squash = self.squash.max(0.0);
        self
    }

    /// Returns the cylinder with less curvature if it does not reach this far from its axis.
    fn within(mut self, reach: f64) -> Self {
        if self.squash * reach * reach >= 1.0 {
            self.squash = 0.9 / (reach * reach);
            if self.is_round {
                self.bend = self.bend.signum() * (self.squash * (1.0 + self.tilt * self.tilt)).sqrt();
            }
        }
        self
    }

    fn moved(mut self, step: &Vector) -> Self {
        self.angle += step[0];
        self.offset += step[1];
        self.tilt += step[2];
        self.base += step[3];
        self.bend += step[4];
        self.squash += step[5];
        self.tied()
    }

    /// Returns the height in the unit of the surface. NaN beside the cylinder.
    fn height(&self, at: [f64; 2]) -> f64 {
        self.unit * self.height_and_gradient(at).0
    }

    /// Returns the height, in the cylinder's unit, and its derivatives by angle, offset, tilt, base, bend and squash.
    fn height_and_gradient(&self, [x, y]: [f64; 2]) -> (f64, Vector) {
        let (sin, cos) = self.angle.sin_cos();
        let (e, d) = (x * cos + y * sin, y * cos - x * sin - self.offset);
        let root = (1.0 - self.squash * d * d).sqrt();
        let sagitta = d * d / (1.0 + root);
        let by_d = self.bend * d / root;
        let by_squash = self.bend * d.powi(4) / (2.0 * root * (1.0 + root).powi(2));
        let [mut by_tilt, mut by_bend, mut last] = [e, sagitta, by_squash];
        if self.is_round {
            let stretch = 1.0 + self.tilt * self.tilt;
            by_tilt -= by_squash * 2.0 * self.tilt * (self.bend / stretch).powi(2);
            by_bend += by_squash * 2.0 * self.bend / stretch;
            last = 0.0;
        }
        let by_angle = self.tilt * (d + self.offset) - by_d * e;
        let height = self.base + self.tilt * e + self.bend * sagitta;
        (height, Vector::from([by_angle, -by_d, by_tilt, 1.0, by_bend, last]))
    }
}

#[cfg(test)]
mod tests {
    use super::super::areal::tests::surface;
    use super::*;

    fn left(mut of: Surface, form: Form, pixel: Option<f64>) -> f64 {
        let missing = of.values.len() / 3;
        of.values[missing..missing + 40].fill(f64::NAN);
        of.subtract_form(form, pixel).unwrap();
        assert!(of.values[missing].is_nan());
        of.values.iter().filter(|z| z.is_finite()).fold(0.0, |largest: f64, z| largest.max(z.abs()))
    }

    /// A circular cylinder whose axis turns and rises, in heights of 0.01 a pixel.
    fn cylinder(radius: f64, angle: f64, tilt: f64, sign: f64) -> Surface {
        surface([90, 70], |x, y| {
            let [x, y] = [0.01 * (x - 38.0), 0.01 * (y - 40.0)];
            let (e, d) = (x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin());
            3.0 + tilt * e + sign * (1.0 + tilt * tilt).sqrt() * (radius * radius - d * d).sqrt()
        })
    }

    #[test]
    fn a_plane_and_a_quadric_are_removed() {
        let plane = || surface([50, 40], |x, y| 12.0 + 0.3 * x - 0.7 * y);
        assert!(left(plane(), Form::Plane, None) < 1e-10);
        assert!(left(plane(), Form::Quadric, None) < 1e-10);
        let quadric = || surface([50, 40], |x, y| 1.0 + 0.1 * x + 0.02 * x * x - 0.03 * x * y + 0.01 * y * y);
        assert!(left(quadric(), Form::Quadric, None) < 1e-9);
        assert!(left(quadric(), Form::Plane, None) > 1.0);
        assert_eq!(left(surface([50, 40], |_, _| 2.0), Form::None, None), 2.0);
    }

    #[test]
    fn a_cylinder_is_removed_whatever_its_axis() {
        for (radius, angle, tilt, sign) in
            [(0.6, 0.0, 0.0, 1.0), (0.9, 1.2, 0.1, 1.0), (2.0, -0.5, -0.3, -1.0), (30.0, 0.8, 0.05, 1.0)]
        {
            let round = left(cylinder(radius, angle, tilt, sign), Form::Cylinder, Some(0.01));
            let any = left(cylinder(radius, angle, tilt, sign), Form::Cylinder, None);
            println!("radius {radius}, angle {angle}: {round:.1e} of a circle, {any:.1e} of an ellipse are left");
            assert!(round < 1e-6 && any < 1e-4, "radius {radius}, angle {angle}: {round} {any}");
        }
        // In other heights the section is an ellipse.
        let mut scaled = cylinder(0.9, 1.2, 0.1, 1.0);
        scaled.values.iter_mut().for_each(|z| *z *= 40.0);
        assert!(left(scaled, Form::Cylinder, None) < 4e-3);
    }

    #[test]
    fn what_does_not_determine_a_form_is_an_error() {
        let mut line = surface([50, 40], |x, _| x);
        line.values[50..].fill(f64::NAN);
        let message = line.subtract_form(Form::Plane, None).unwrap_err().to_string();
        assert!(message.contains("do not determine the form"), "{message}");
        let mut plane = surface([50, 40], |x, y| 0.3 * x + y);
        let message = plane.subtract_form(Form::Cylinder, Some(1.0)).unwrap_err().to_string();
        assert!(message.contains("too little curvature"), "{message}");
    }
}
