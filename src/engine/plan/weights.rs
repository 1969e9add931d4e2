//! The weights of all filters of a solve.

use crate::engine::filter::Filter;
use crate::engine::stages::{convolve, stack};

/// A filter among all the weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FilterRange {
    pub(crate) bank: usize,
    /// In fours.
    pub(crate) offset: u32,
    pub(crate) blocks: u32,
    pub(crate) radius: u32,
}

/// How a layer of a stack is made: from which, and by the sum of which filters along x and along y.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StackLayer {
    pub(crate) from: u32,
    pub(crate) sampling: stack::Sampling,
    pub(crate) terms: Vec<[FilterRange; 2]>,
}

/// The weights of all filters, in banks that fit a uniform buffer each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub(crate) banks: Vec<Vec<f64>>,
}

impl Weights {
    pub(super) fn add(&mut self, filter: &Filter) -> FilterRange {
        let blocks = (filter.len() as u32).div_ceil(convolve::BLOCK);
        let length = (blocks * convolve::BLOCK) as usize;
        if self.banks.last().is_none_or(|bank| bank.len() + length > convolve::WEIGHTS) {
            self.banks.push(Vec::new());
        }
        let bank = self.banks.len() - 1;
        let weights = &mut self.banks[bank];
        let (offset, radius) = (weights.len() as u32 / 4, (filter.len() / 2) as u32);
        let end = weights.len() + length;
        weights.extend(filter);
        weights.resize(end, 0.0);
        FilterRange { bank, offset, blocks, radius }
    }
}
