//! Regions and lines as they are written on the command line.

use std::str::FromStr;

use parfocal::Region;
use parfocal::metric::measure::Line;

/// `X,Y,W,H`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RegionArgument(pub(crate) Region);

impl FromStr for RegionArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<u32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y, width, height]) => Ok(Self(Region { x, y, width, height })),
            _ => Err("give X,Y,WIDTH,HEIGHT in whole pixels, as in 40,60,32,32".to_string()),
        }
    }
}

/// `X,Y,W,H=Z`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RegionAtDepth(pub(crate) Region, pub(crate) f64);

impl FromStr for RegionAtDepth {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('=').and_then(|(region, z)| {
            let RegionArgument(region) = region.parse().ok()?;
            Some(Self(region, z.trim().parse().ok()?))
        });
        parsed.ok_or_else(|| "give X,Y,WIDTH,HEIGHT=DEPTH in pixels and mm, as in 40,60,32,32=529".to_string())
    }
}

/// `X1,Y1,X2,Y2`, perhaps with `,WIDTH`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineArgument(pub(crate) Line);

impl FromStr for LineArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        let line = |x1, y1, x2, y2, width| Ok(Self(Line { from: [x1, y1], to: [x2, y2], width }));
        match numbers.as_deref() {
            Some(&[x1, y1, x2, y2]) => line(x1, y1, x2, y2, 1.0),
            Some(&[x1, y1, x2, y2, width]) => line(x1, y1, x2, y2, width),
            _ => Err("give X1,Y1,X2,Y2 in pixels and perhaps the width, as in 10,40,300,40,9".to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_understood_or_refused_with_an_example() {
        let RegionAtDepth(region, z) = "1,2, 3,4 = 52.5".parse().unwrap();
        assert_eq!((region.x, region.y, region.width, region.height, z), (1, 2, 3, 4, 52.5));
        let LineArgument(line) = "0,1.5,20,1.5,7".parse().unwrap();
        assert_eq!((line.from, line.to, line.width), ([0.0, 1.5], [20.0, 1.5], 7.0));
        assert_eq!("0,1,20,1".parse::<LineArgument>().unwrap().0.width, 1.0);
        for bad in ["1,2,3", "1,2,3,x", "", "1,2,3,-4"] {
            assert!(bad.parse::<RegionArgument>().unwrap_err().contains("as in"), "{bad}");
        }
        assert!("1,2,3,4".parse::<RegionAtDepth>().is_err() && "1,2,3".parse::<LineArgument>().is_err());
    }
}
