//! Fields of numbers with the border rule of the shaders, for the CPU references.

/// `height` rows of `width` numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Numbers per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub data: Vec<f64>,
}

impl Field {
    /// A field with `value(x, y)` at each place.
    pub fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let data = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect();
        Self { width, height, data }
    }

    /// A field of zeros.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![0.0; width * height] }
    }

    /// From the numbers of an image on the device.
    pub fn from_f32(width: usize, height: usize, data: &[f32]) -> Self {
        Self { width, height, data: data.iter().map(|&v| f64::from(v)).collect() }
    }

    /// The corner of a wider image on the device with `row` numbers per row.
    pub(crate) fn corner(data: &[f32], row: usize, [width, height]: [usize; 2]) -> Self {
        let mut corner = Self { width, height, data: Vec::with_capacity(width * height) };
        for row in data.chunks_exact(row).take(height) {
            corner.data.extend(row[..width].iter().map(|&v| f64::from(v)));
        }
        corner
    }

    /// As numbers of an image on the device.
    pub fn to_f32(&self) -> Vec<f32> {
        self.data.iter().map(|&v| v as f32).collect()
    }

    /// The number at a place inside.
    pub fn get(&self, x: usize, y: usize) -> f64 {
        self.data[y * self.width + x]
    }

    /// The number at a place, mirrored about the border pixels.
    pub fn mirrored(&self, x: isize, y: isize) -> f64 {
        self.get(mirror(x, self.width), mirror(y, self.height))
    }

    /// The number at the nearest place inside.
    pub fn clamped(&self, x: isize, y: isize) -> f64 {
        self.get(x.clamp(0, self.width as isize - 1) as usize, y.clamp(0, self.height as isize - 1) as usize)
    }
}

/// Reflects about 0 and `size - 1`, repeatedly.
pub fn mirror(i: isize, size: usize) -> usize {
    fold(i, 2 * (size - 1))
}

/// Reflects about 0 and half a period, repeatedly.
pub fn fold(i: isize, period: usize) -> usize {
    let j = i.unsigned_abs() % period.max(1);
    j.min(period.max(1) - j)
}

#[cfg(test)]
mod tests {
    use super::mirror;

    #[test]
    fn mirror_reflects_about_the_border_pixels() {
        let expected = [1, 0, 1, 2, 1, 0, 1, 2, 1, 0];
        let actual: Vec<usize> = (-5..5).map(|i| mirror(i, 3)).collect();
        assert_eq!(actual, expected);
        assert_eq!(mirror(-7, 1), 0);
    }
}
