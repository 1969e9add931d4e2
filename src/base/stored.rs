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

/// A homography in a file: what it does at the centre, and the matrix unless that is all.
#[derive(Serialize, Deserialize)]
pub(super) struct Homography {
    #[serde(flatten)]
    at_centre: Similarity,
    #[serde(skip_serializing_if = "Option::is_none")]
    matrix: Option<[[f64; 3]; 3]>,
}

impl TryFrom<Homography> for base::Homography {
    type Error = String;

    fn try_from(t: Homography) -> Result<Self, Self::Error> {
        let Some(matrix) = t.matrix else {
            let scale = t.at_centre.scale;
            // As a matrix, a negative one is half a turn.
            return if scale > 0.0 {
                Ok(base::Similarity::from(t.at_centre).into())
            } else {
                Err(format!("scale is {scale}, and must be above 0"))
            };
        };
        let problem = "the matrix has no inverse, or mirrors: it must be [[M, t], [g, 1]] of what maps I1 to I2";
        Self::from_matrix(matrix).ok_or_else(|| problem.to_string())
    }
}

impl From<base::Homography> for Homography {
    fn from(t: base::Homography) -> Self {
        let (at_centre, matrix) = (t.at_centre().into(), t.similarity().is_none().then(|| t.matrix()));
        Self { at_centre, matrix }
    }
}

/// κ of a lens in a file that does not state it.
pub(super) fn disk() -> f64 {
    Lens::DISK
}
