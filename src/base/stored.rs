//! The nouns in the units of files: what serde reads and writes in their place.

use serde::{Deserialize, Serialize};

use crate::base::{self, Lens};

/// A similarity in a file.
#[derive(Serialize, Deserialize)]
pub(super) struct Similarity {
    tx_px: f64,
    ty_px: f64,
    rotation_deg: f64,
    scale: f64,
}

impl From<Similarity> for base::Similarity {
    fn from(t: Similarity) -> Self {
        Self::new(t.tx_px, t.ty_px, t.rotation_deg, t.scale)
    }
}

impl From<base::Similarity> for Similarity {
    fn from(t: base::Similarity) -> Self {
        Self { tx_px: t.tx, ty_px: t.ty, rotation_deg: t.rotation_deg(), scale: t.scale }
    }
}

/// κ of a lens in a file that does not state it.
pub(super) fn disk() -> f64 {
    Lens::DISK
}
