//! How parts lie in their pictures: the range that good parts teach.

use super::golden::student;
use crate::base::Similarity;

/// The least allowances: a registration is off by less, and a part that lies so is compared as well as any. A share of
/// the diagonal, degrees, and a share of the scale.
const LEAST: [f64; 3] = [0.02, 0.5, 0.005];

/// The range of similarities that a registration may find.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PlacementRange {
    /// The middle of the range.
    pub middle: Similarity,
    /// The largest distance of the image centre from where the middle has it, px.
    pub max_shift_px: f64,
    /// The largest rotation from the middle, degrees.
    pub max_rotation_deg: f64,
    /// The largest change of the scale from the middle, as a share.
    pub max_scale: f64,
}

impl PlacementRange {
    /// The range without a limit.
    pub const ANY: Self = Self {
        middle: Similarity::IDENTITY,
        max_shift_px: f64::INFINITY,
        max_rotation_deg: f64::INFINITY,
        max_scale: f64::INFINITY,
    };

    /// Returns the range in which good parts lie, for pictures of this size, px. If parts scatter as a Gaussian, one good
    /// part in 400 lies beyond it. `None` for fewer than three parts, or for infinite values.
    pub fn taught(parts: &[Similarity], [width, height]: [u32; 2]) -> Option<Self> {
        let count = parts.len() as f64;
        let mean = |of: &dyn Fn(&Similarity) -> f64| parts.iter().map(of).sum::<f64>() / count;
        let rotation = mean(&|t| t.rotation.sin()).atan2(mean(&|t| t.rotation.cos()));
        let middle = Similarity { tx: mean(&|t| t.tx), ty: mean(&|t| t.ty), rotation, scale: mean(&|t| t.scale) };
        let beyond = student((parts.len() > 2).then(|| parts.len() - 1)?) * (1.0 + 1.0 / count).sqrt();
        let diagonal = f64::from(width).hypot(f64::from(height));
        let scatter = [0, 1, 2].map(|n| {
            let squares = parts.iter().map(|t| distance(&middle, t)[n].powi(2)).sum::<f64>();
            3.0 * beyond * (squares / (count - 1.0)).sqrt()
        });
        let range = Self {
            middle,
            max_shift_px: scatter[0].max(LEAST[0] * diagonal),
            max_rotation_deg: scatter[1].max(LEAST[1]),
            max_scale: scatter[2].max(LEAST[2]),
        };
        scatter.iter().all(|scatter| scatter.is_finite()).then_some(range)
    }

    /// Returns why a similarity is out of the range, as the end of a sentence.
    pub fn problem(&self, found: &Similarity) -> Option<String> {
        let [shift, rotation, scale] = distance(&self.middle, found);
        match self {
            _ if shift > self.max_shift_px => {
                Some(format!("by {shift:.1} px, and {:.1} px are allowed", self.max_shift_px))
            }
            _ if rotation > self.max_rotation_deg => {
                Some(format!("turned by {rotation:.1}°, and {:.1}° are allowed", self.max_rotation_deg))
            }
            _ if scale > self.max_scale => {
                Some(format!("scaled by {:.1} %, and {:.1} % are allowed", 100.0 * scale, 100.0 * self.max_scale))
            }
            _ => None,
        }
    }
}

/// Returns how far two similarities are apart: shift of the image centre, px, rotation, degrees, share of the scale.
fn distance(a: &Similarity, b: &Similarity) -> [f64; 3] {
    let turn = b.rotation - a.rotation;
    let rotation = turn.sin().atan2(turn.cos()).to_degrees().abs();
    [(b.tx - a.tx).hypot(b.ty - a.ty), rotation, (b.scale / a.scale - 1.0).abs()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn good_parts_teach_where_the_next_may_lie() {
        let parts = [[0.0, 0.0, 0.0], [4.0, -2.0, 179.0], [-3.0, 1.0, -179.0], [1.0, 3.0, 180.0], [2.0, 0.0, 180.5]];
        let at = |[tx, ty, turn]: [f64; 3]| Similarity::new(tx, ty, turn, 1.0);
        let turned = parts.map(|[tx, ty, turn]| at([tx, ty, if turn == 0.0 { 180.0 } else { turn }]));
        let range = PlacementRange::taught(&turned, [400, 300]).unwrap();
        assert!(range.problem(&at([6.0, 4.0, -178.0])).is_none(), "{range:?}");
        assert!(range.problem(&at([0.0, 0.0, 0.0])).unwrap().contains("turned by 179.9°"), "{range:?}");
        assert!(range.problem(&at([90.0, 0.0, 180.0])).unwrap().contains("px are allowed"), "{range:?}");
        let same = PlacementRange::taught(&[Similarity::IDENTITY; 3], [400, 300]).unwrap();
        assert_eq!((same.max_shift_px, same.max_rotation_deg, same.max_scale), (10.0, 0.5, 0.005));
        assert!(same.problem(&Similarity::new(0.0, 0.0, 0.0, 1.02)).unwrap().contains("scaled by 2.0 %"));
        assert!(PlacementRange::ANY.problem(&at([1e3, 0.0, 90.0])).is_none());
        assert_eq!(PlacementRange::taught(&turned[..2], [400, 300]), None);
    }
}
