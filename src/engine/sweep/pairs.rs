//! Which frames of a sweep are compared.

/// Px of blur that the frames of a pair differ by at least, about: closer, noise outweighs what differs.
const APART: f64 = 0.75;

/// Frames from one to the next that is [`APART`].
pub(super) fn stride(settings: &[f64], rate: f64) -> f64 {
    let last = (settings.len() - 1) as f64;
    let mean = (settings[settings.len() - 1] - settings[0]) / last;
    (APART / (rate.sqrt() * mean)).round().clamp(1.0, last)
}

/// Pairs of frames at ascending settings p: those about [`APART`] px of blur from each other, and those about twice as far, where c is
/// `rate`. In strides of frames that are even: s and 2 s + 1 (2 if s is 1), which have no common divisor, so that the pairs link all
/// frames; of uneven ones the frames that come nearest. What is still unlinked is linked by neighbours.
pub(super) fn pairs(settings: &[f64], rate: f64) -> Vec<[usize; 2]> {
    let last = settings.len() - 1;
    let mean = (settings[last] - settings[0]) / last as f64;
    let stride = stride(settings, rate);
    let wider = 2.0 * stride + if stride > 1.0 { 1.0 } else { 0.0 };
    let mut pairs = Vec::new();
    for stride in [stride, wider] {
        for i in 0..last {
            let wanted = settings[i] + stride * mean;
            if wanted > settings[last] + 0.5 * mean {
                continue;
            }
            let off = |j: &usize| (settings[*j] - wanted).abs();
            pairs.extend((i + 1..=last).min_by(|a, b| off(a).total_cmp(&off(b))).map(|j| [i, j]));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    link(&mut pairs, settings.len());
    pairs
}

/// Adds neighbours until all frames are linked.
fn link(pairs: &mut Vec<[usize; 2]>, frames: usize) {
    let mut group: Vec<usize> = (0..frames).collect();
    let join = |group: &mut Vec<usize>, [i, j]: [usize; 2]| {
        let (from, to) = (group[j], group[i]);
        group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
    };
    pairs.iter().for_each(|pair| join(&mut group, *pair));
    for i in 1..frames {
        if group[i - 1] != group[i] {
            pairs.push([i - 1, i]);
            join(&mut group, [i - 1, i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strides_follow_the_blur_and_link_all_frames() {
        let even: Vec<f64> = (0..9).map(f64::from).collect();
        // 0.25 px a step: 3 steps, and 7.
        let found = pairs(&even, 0.0625);
        assert!(found.contains(&[0, 3]) && found.contains(&[5, 8]) && found.contains(&[1, 8]), "{found:?}");
        assert!(found.iter().all(|[i, j]| [1, 3, 7].contains(&(j - i))));
        assert!(pairs(&even, 4.0).iter().all(|[i, j]| j - i <= 2));
        for settings in [even, vec![0.0, 0.1, 0.2, 5.0, 9.0], vec![0.0, 1.0]] {
            for rate in [1e-4, 0.03, 1.0, 50.0] {
                let mut reached = vec![0];
                let found = pairs(&settings, rate);
                for _ in 0..settings.len() {
                    let next = found.iter().flat_map(|&[i, j]| [(i, j), (j, i)]).filter(|(i, _)| reached.contains(i));
                    reached = next.map(|(_, j)| j).chain(reached.iter().copied()).collect();
                    reached.sort_unstable();
                    reached.dedup();
                }
                assert_eq!(reached.len(), settings.len(), "{settings:?} {rate}");
            }
        }
    }
}
