//! Computes the distribution of an outline's displacement and the evidence for the outline, in both orders.
//! Section 7 of `docs/method.md`.
//!
//! The costs E of a cell are averaged with those of its neighbours on the same edge. With a temperature τ the
//! distribution of the displacement is proportional to `exp(-E/τ)`. Stored is its sum up to each displacement.
//!
//! The evidence for an outline: the cost of V as it is less the least cost, in both orders; the variance of the
//! displacement, for both, or `OUTSIDE` where its mean is at an end of the range; the least cost of the other order less
//! that of this one; and how many cells within two continue the edge.

use super::edge::{self, BEFORE, COSTS, DECISIONS, DISPLACEMENTS, EDGES, Edge, OUTLINES, REVERSED_COSTS, TOTAL};
use super::pass::{Memory, Pass};
use super::{Number, Raster};
use crate::engine::vulkan::Variant;

pub use super::interface::edge_decide::*;
use crate::engine::shaders::edge_decide as shader;

impl Pass for Bindings {
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        edge::traffic([c.width, c.height])
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let layer = |n| memory.layer(self.results, n);
        let [near, far, decisions] =
            cpu_reference([c.width, c.height], [layer(COSTS), layer(REVERSED_COSTS)], layer(EDGES));
        memory.set_layer(self.results, OUTLINES[0], near);
        memory.set_layer(self.results, OUTLINES[1], far);
        memory.set_layer(self.results, DECISIONS, decisions);
    }
}

/// The layers of the distributions, by order, and of the decisions.
pub(crate) fn cpu_reference<N: Number>(size: [u32; 2], costs: [&Raster<N>; 2], edges: &Raster<N>) -> [Raster<N>; 3] {
    let mut layers = [(); 3].map(|()| Raster::zeros(edges.width, edges.height));
    for cell in edge::all_cells(size) {
        let Some(edge) = Edge::of(edges, cell) else { continue };
        let (mut mean, mut before, mut sum, mut length) = ([[0.0; DISPLACEMENTS]; 2], [0.0; 2], 0.0, 0.0);
        for other in edge::cells_around(cell, shader::AROUND as usize, size) {
            let Some(neighbour) = Edge::of(edges, other) else { continue };
            let total = edge::number(edges, other, TOTAL);
            if total == 0.0 {
                continue;
            }
            let apart: f64 = [0, 1].map(|i| (other[i] as f64 - cell[i] as f64).powi(2)).iter().sum();
            let agreement = edge.agreement(&neighbour);
            length += agreement;
            let weight = agreement * (-apart / (2.0 * shader::SPREAD)).exp();
            sum += weight;
            let weight = weight / total;
            for order in 0..2 {
                before[order] += weight * edge::number(costs[order], other, BEFORE);
                for (n, mean) in mean[order].iter_mut().enumerate() {
                    *mean += weight * edge::number(costs[order], other, n);
                }
            }
        }
        // No pair of frames shows the edge: it stays as it is.
        if sum == 0.0 {
            length = -1e6;
        }
        let sum = f64::max(sum, 1e-6);
        let mut least = [0.0; 2];
        for (order, costs) in mean.iter().enumerate() {
            least[order] = costs.iter().copied().fold(f64::MAX, f64::min);
            let density = costs.map(|cost| (-(cost - least[order]) / (shader::TEMPERATURE * sum)).exp());
            let total: f64 = density.iter().sum();
            let place = density.iter().enumerate().map(|(n, p)| n as f64 * p).sum::<f64>() / total;
            let mut share = 0.0;
            let shares = density.map(|p| {
                share += p / total;
                share
            });
            edge::set(&mut layers[order], cell, 0, &shares);
            let away = |n: usize| (n as f64 - place).powi(2);
            let variance = density.iter().enumerate().map(|(n, p)| away(n) * p).sum::<f64>() / total;
            let is_within = place > 1.0 && place < (DISPLACEMENTS - 2) as f64;
            edge::set(&mut layers[2], cell, order, &[(before[order] - least[order]) / sum]);
            edge::set(&mut layers[2], cell, 2 + order, &[if is_within { variance } else { shader::OUTSIDE }]);
        }
        edge::set(&mut layers[2], cell, 4, &[(least[1] - least[0]) / sum, length]);
    }
    layers
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn the_variance_of_the_displacement_is_that_of_its_distribution() {
        let [mut edges, mut costs] = [(); 2].map(|()| Field::zeros(4, 4));
        edge::set(&mut edges, [0, 0], 0, &[1.0]);
        edge::set(&mut edges, [0, 0], TOTAL, &[1.0, 2.0, 2.0, 1.0, 0.0, 1.0, -1.0]);
        // Costs by displacement; others are 1000. The other order costs the same everywhere.
        let mut variances = |total: f64, least: &[(usize, f64)]| {
            let mut numbers = [1000.0 * total; BEFORE + 1];
            least.iter().for_each(|&(n, cost)| numbers[n] = total * cost);
            edge::set(&mut edges, [0, 0], TOTAL, &[total]);
            edge::set(&mut costs, [0, 0], 0, &numbers);
            let decisions = &cpu_reference([4, 4], [&costs, &Field::zeros(4, 4)], &edges)[2];
            [2, 3].map(|n| edge::number(decisions, [0, 0], n))
        };
        let unknown = ((DISPLACEMENTS * DISPLACEMENTS - 1) as f64) / 12.0;
        // At an end of the range there may be a better place beyond.
        for (n, variance) in [(0, shader::OUTSIDE), (1, shader::OUTSIDE), (2, 0.0), (12, 0.0), (13, shader::OUTSIDE)] {
            let [of_near, of_far] = variances(1.0, &[(n, 0.0)]);
            assert!((of_near - variance).abs() < 1e-9 && (of_far - unknown).abs() < 1e-9, "{n}: {of_near}, {of_far}");
        }
        assert!((unknown - shader::OUTSIDE).abs() < 1e-3);
        for total in [1.0, 2.0] {
            assert!((variances(total, &[(3, 0.0), (9, 0.0)])[0] - 9.0).abs() < 1e-9);
            // Weights of 3/4 and 1/4.
            let third = shader::TEMPERATURE * 3f64.ln();
            assert!((variances(total, &[(5, 0.0), (7, third)])[0] - 0.75).abs() < 1e-9);
        }
    }
}
