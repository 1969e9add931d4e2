//! Shape from focus: the setting at which the neighbourhood of each pixel has the most detail.
//!
//! Detail is the modified Laplacian (Nayar and Nakagawa 1994), `|2I - I_left - I_right| + |2I - I_above - I_below|`, in
//! a Gaussian window. A parabola is fitted to the logarithm of detail in the frame with the most detail and its
//! neighbours, as the blur of a sweep suggests. Its vertex is u.

use parfocal::{
    Error, Frame,
    internals::LUMINANCE,
    internals::stages::{Field, ingest},
    settings::Decode,
};

/// Standard deviation of the window, px.
const WINDOW: f64 = 4.0;
/// Distance at which the window is cut off, in standard deviations.
const REACH: f64 = 4.0;
/// Added to the detail, white = 1, so that its logarithm is finite.
const LEAST: f64 = 1e-6 / 255.0;

/// The setting at which each pixel is in focus, between the least and the greatest of `positions`.
///
/// The frames must be registered and have equal brightness. Their positions ascend or descend.
///
/// # Errors
/// [`Error::Mismatch`]: fewer than three frames, or sizes or positions that do not match.
pub fn shape_from_focus(frames: &[Frame], positions: &[f64], decode: Decode) -> Result<Vec<f32>, Error> {
    let size = |frame: &Frame| [frame.width(), frame.height()];
    let fits = frames.len() >= 3 && frames.len() == positions.len();
    if !fits || frames.iter().any(|frame| size(frame) != size(&frames[0])) {
        let problem = "shape from focus takes three frames or more, of one size, and a position for each";
        return Err(Error::Mismatch(problem.to_string()));
    }
    let details = frames.iter().map(|frame| detail(&ingest::cpu_reference(frame, decode, LUMINANCE)).data);
    let details: Vec<Vec<f64>> = details.collect();
    let setting = |i: usize| {
        let most = (0..details.len()).fold(0, |most, k| if details[k][i] > details[most][i] { k } else { most });
        let middle = most.clamp(1, details.len() - 2);
        let around = [middle - 1, middle, middle + 1];
        vertex(around.map(|k| positions[k]), around.map(|k| (details[k][i] + LEAST).ln())) as f32
    };
    Ok((0..details[0].len()).map(setting).collect())
}

/// The modified Laplacian, averaged in a window. Pixels are mirrored at the border.
fn detail(image: &Field) -> Field {
    let laplacian = |x: usize, y: usize| {
        let at = |dx: isize, dy: isize| image.mirrored(x as isize + dx, y as isize + dy);
        let middle = 2.0 * at(0, 0);
        (middle - at(-1, 0) - at(1, 0)).abs() + (middle - at(0, -1) - at(0, 1)).abs()
    };
    let raw = Field::from_fn(image.width, image.height, laplacian);
    windowed(&windowed(&raw, [1, 0]), [0, 1])
}

/// Smooths a field along x or y.
fn windowed(field: &Field, [dx, dy]: [isize; 2]) -> Field {
    let reach = (REACH * WINDOW) as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|d| (-(d as f64 / WINDOW).powi(2) / 2.0).exp()).collect();
    let sum: f64 = weights.iter().sum();
    Field::from_fn(field.width, field.height, |x, y| {
        let at = |d: isize| field.mirrored(x as isize + d * dx, y as isize + d * dy);
        weights.iter().zip(-reach..).map(|(weight, d)| weight * at(d)).sum::<f64>() / sum
    })
}

/// The x of the vertex of the parabola through three points, clamped between them. The middle x if the parabola has no
/// maximum.
fn vertex([p0, p1, p2]: [f64; 3], [a, b, c]: [f64; 3]) -> f64 {
    let (before, after) = ((b - a) / (p1 - p0), (c - b) / (p2 - p1));
    let curvature = (after - before) / (p2 - p0);
    if curvature < -1e-9 { ((p0 + p1) / 2.0 - before / (2.0 * curvature)).clamp(p0.min(p2), p0.max(p2)) } else { p1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal::{
        internals::median,
        internals::scene::{Preset, Scene, SweepScene},
    };

    #[test]
    fn the_vertex_of_a_parabola_is_recovered_from_uneven_positions() {
        let of = |p: f64| 3.0 - 2.0 * (p - 1.7) * (p - 1.7);
        for positions in [[1.0, 2.0, 2.5], [2.5, 2.0, 1.0], [0.0, 1.7, 3.0]] {
            assert!((vertex(positions, positions.map(of)) - 1.7).abs() < 1e-12);
        }
        assert_eq!(vertex([0.0, 1.0, 2.0], [5.0, 1.0, 2.0]), 1.0, "a valley");
        assert!((vertex([0.0, 1.0, 2.0], [5.0, 4.9, 1.0]) - (1.0 - 2.0 / 3.8)).abs() < 1e-12, "within a step");
        assert_eq!(vertex([0.0, 1.0, 2.0], [5.0, 1.0, -3.1]), 0.0, "beyond the end");
    }

    #[test]
    fn a_simulated_sweep_is_solved_to_a_fraction_of_a_step() {
        let scene = Scene { width: 160, height: 96, noise: 0.002, ..Preset::Plane.scene() };
        let sweep = SweepScene::new(scene, 11).render().unwrap();
        let positions: Vec<f64> = sweep.shots.iter().map(|shot| 20.0 + 0.5 * shot.position).collect();
        let focus = shape_from_focus(&sweep.frames, &positions, Decode::None).unwrap();
        let off = |i: usize| (2.0 * (f64::from(focus[i]) - 20.0) - f64::from(sweep.focus[i])).abs();
        let inside = (16..80).flat_map(|y| (16..144).map(move |x| y * 160 + x));
        let off = median(inside.map(off)).unwrap();
        assert!(off < 0.25, "{off} of a step");
    }

    #[test]
    fn too_few_frames_or_positions_are_refused() {
        let frame = Frame::gray(16, 16, vec![0.5; 256]).unwrap();
        let problem = |frames: usize, positions: &[f64]| {
            shape_from_focus(&vec![frame.clone(); frames], positions, Decode::None).unwrap_err().to_string()
        };
        assert!(problem(2, &[0.0, 1.0]).contains("three frames") && problem(3, &[0.0]).contains("a position for each"));
    }
}
