//! Straightens edges: of each cell, the place and the normal on the line through the cells along its edge, and V of
//! either side there. Section 7 of `docs/method.md`.
//!
//! Noise makes the places where V is halfway wind by a pixel or two around the outline. A displacement is counted from
//! the cell's place: only on a straightened edge is the same displacement the same outline in neighbouring cells. The
//! line is fitted by least squares in the axes of the cell's own normal.
//!
//! V of a side has noise of a few pixels in a single cell. It becomes the mean over the cells along the edge; those
//! that have another surface on either side count little.

use super::edge::{self, EDGES, Edge, STRAIGHT};
use super::pass::{Memory, Pass};
use super::{Number, Raster};
use crate::engine::vulkan::Variant;

pub use super::interface::edge_straighten::*;
use crate::engine::shaders::edge_straighten as shader;

impl Pass for Bindings {
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        edge::traffic([c.width, c.height])
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let edges = cpu_reference([c.width, c.height], memory.layer(self.results, EDGES));
        memory.set_layer(self.results, EDGES, edges);
    }
}

/// The layer of the edges with the places, normals and V of either side on the straightened edges.
pub(crate) fn cpu_reference<N: Number>(size: [u32; 2], edges: &Raster<N>) -> Raster<N> {
    let mut straightened = edges.clone();
    for cell in edge::all_cells(size) {
        let Some(edge) = Edge::found(edges, cell) else { continue };
        let normal = edge.normal;
        let tangent = [-normal[1], normal[0]];
        let (mut sum, mut mean, mut product, mut square) = (0.0, [0.0; 2], 0.0, 0.0);
        let (mut alike, mut levels) = (0.0, [0.0; 2]);
        let jump = edge.levels[0] - edge.levels[1];
        for other in edge::cells_around(cell, shader::AROUND as usize, size) {
            let Some(neighbour) = Edge::found(edges, other) else { continue };
            let cells: f64 = [0, 1].map(|i| (other[i] as f64 - cell[i] as f64).powi(2)).iter().sum();
            let weight = edge.agreement(&neighbour) * (-cells / (2.0 * shader::SPREAD)).exp();
            let apart = [0, 1].map(|i| neighbour.place[i] - edge.place[i]);
            let at = [tangent, normal].map(|axis| apart[0] * axis[0] + apart[1] * axis[1]);
            sum += weight;
            mean = [0, 1].map(|i| mean[i] + weight * at[i]);
            product += weight * at[0] * at[1];
            square += weight * at[0] * at[0];
            let differences: f64 = [0, 1].map(|i| (neighbour.levels[i] - edge.levels[i]).powi(2)).iter().sum();
            let weight = weight * (-differences / (2.0 * (shader::ALIKE * jump).powi(2))).exp();
            alike += weight;
            levels = [0, 1].map(|i| levels[i] + weight * neighbour.levels[i]);
        }
        let mean = mean.map(|total| total / sum);
        let slope = (product / sum - mean[0] * mean[1]) / (square / sum - mean[0] * mean[0] + shader::LEAST_VARIANCE);
        let place = [0, 1].map(|i| edge.place[i] + (mean[1] - slope * mean[0]) * normal[i]);
        let line = [0, 1].map(|i| (normal[i] - slope * tangent[i]) / slope.hypot(1.0));
        let [near, far] = levels.map(|total| total / alike);
        edge::set(&mut straightened, cell, STRAIGHT, &[place[0], place[1], line[0], line[1], near, far]);
    }
    straightened
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn cells_that_wind_around_a_line_come_to_lie_on_it() {
        // A line through (20, 0) along (0.2, 1); the places are off it by up to 1 px, the normals by up to 0.2.
        let (mut edges, size) = (Field::zeros(64, 80), [64, 80]);
        let normal = [1.0, -0.2].map(|n: f64| n / 1.04f64.sqrt());
        for n in 0..20 {
            let off = if n % 2 == 0 { 1.0 } else { -1.0 };
            let at = |off: f64| [20.0 + 0.2 * (4.0 * n as f64 + 1.5) + off * normal[0], 4.0 * n as f64 + 1.5];
            let turned = [normal[0] + 0.2 * off * normal[1], normal[1] - 0.2 * off * normal[0]];
            let length = turned[0].hypot(turned[1]);
            let edge =
                Edge { place: at(off), normal: turned.map(|t| t / length), levels: [4.0, -3.0], deviations: [0.1; 2] };
            edge::set(&mut edges, edge.place.map(|p| p as usize / edge::CELL), 0, &edge.numbers());
        }
        let edges = cpu_reference(size, &edges);
        for edge in edge::all_cells(size).filter_map(|cell| Edge::of(&edges, cell)) {
            let off = (edge.place[0] - 20.0) * normal[0] + edge.place[1] * normal[1];
            let turned = edge.normal[0] * normal[1] - edge.normal[1] * normal[0];
            let is_inside = (16.0..64.0).contains(&edge.place[1]);
            assert!(!is_inside || off.abs() < 0.3 && turned.abs() < 0.08, "{edge:?}: {off}, {turned}");
        }
    }

    #[test]
    fn levels_are_averaged_as_far_as_the_sides_are_the_same() {
        // Along x = 20, V of the near side is 4 ± 0.5 px². From y = 40 on the far side is another surface.
        let (mut edges, size) = (Field::zeros(64, 80), [64, 80]);
        for n in 0..20 {
            let levels = [if n % 2 == 0 { 4.5 } else { 3.5 }, if n < 10 { -4.0 } else { 1.0 }];
            let edge = Edge { place: [20.0, 4.0 * n as f64 + 1.5], normal: [1.0, 0.0], levels, deviations: [0.1; 2] };
            edge::set(&mut edges, [5, n], 0, &edge.numbers());
        }
        let edges = cpu_reference(size, &edges);
        let found = |cells: std::ops::Range<usize>| cells.map(|n| Edge::of(&edges, [5, n]).unwrap().levels);
        assert!(found(2..6).all(|[near, far]| (near - 4.0).abs() < 0.1 && (far + 4.0).abs() < 1e-6));
        assert!(found(8..10).all(|[_, far]| (far + 4.0).abs() < 0.3));
        assert!(found(10..12).all(|[_, far]| (far - 1.0).abs() < 0.3));
    }
}
