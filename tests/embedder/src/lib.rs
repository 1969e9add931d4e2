//! Helpers of the embedding programs: a pair with known relative blur and registration, and the colour map of V.

use parfocal::Frame;

pub const SIZE: u32 = 96;
/// Variance of the blur of I1, px².
pub const VARIANCE: f64 = 0.5;
/// Displacement from I1 to I2, px.
pub const SHIFT: [f64; 2] = [0.8, -0.6];
/// |V| at which the colour saturates, px².
pub const RANGE: f32 = 1.5;

/// Renders two photographs whose V is `blur(x)`. x is -1 at the left border and 1 at the right border.
pub fn pair(blur: fn(f64) -> f64) -> [Frame; 2] {
    [photograph(|_| VARIANCE, [0.0; 2]), photograph(|x| VARIANCE + blur(x), SHIFT)]
}

/// Renders waves in all directions, blurred by a Gaussian of this variance and displaced by `[dx, dy]`.
fn photograph(variance: impl Fn(f64) -> f64, [dx, dy]: [f64; 2]) -> Frame {
    let waves: Vec<[f64; 3]> = (0..64)
        .map(|n| f64::from(n) * 2.4)
        .map(|n| [(0.2 + 0.006 * n) * n.cos(), (0.2 + 0.006 * n) * n.sin(), n * n])
        .collect();
    let value = |x: f64, y: f64| {
        let variance = variance(2.0 * x / f64::from(SIZE) - 1.0);
        let wave = |[u, v, phase]: &[f64; 3]| (-variance * (u * u + v * v) / 2.0).exp() * (u * x + v * y + phase).cos();
        (0.5 + 0.04 * waves.iter().map(wave).sum::<f64>()) as f32
    };
    let places = (0..SIZE * SIZE).map(|i| (f64::from(i % SIZE) - dx, f64::from(i / SIZE) - dy));
    Frame::gray(SIZE, SIZE, places.map(|(x, y)| value(x, y)).collect()).expect("a frame")
}

/// Returns whether the environment enables validation (`PARFOCAL_VALIDATE=1`).
pub fn validate() -> bool {
    std::env::var_os("PARFOCAL_VALIDATE").is_some_and(|value| value == "1")
}

/// Returns the colour of V: blue where I1 is blurrier, orange where it is sharper, white at 0, black where V is NaN.
pub fn colour(blur: f32) -> [f32; 3] {
    if blur.is_nan() {
        return [0.0; 3];
    }
    let part = (blur / RANGE).clamp(-1.0, 1.0);
    let end = if part < 0.0 { [0.1, 0.3, 0.8] } else { [0.9, 0.5, 0.1] };
    end.map(|channel: f32| 1.0 + part.abs() * (channel - 1.0))
}

/// Checks that an RGBA picture has the colours that `colour` returns for V.
///
/// # Panics
/// The picture differs.
pub fn compare(picture: &[u8], relative_blur: &[f32]) {
    assert_eq!(picture.len(), 4 * relative_blur.len());
    for (i, (drawn, &blur)) in picture.chunks_exact(4).zip(relative_blur).enumerate() {
        let near = |(&drawn, expected): (&u8, f32)| (f32::from(drawn) - 255.0 * expected).abs() < 1.0;
        assert!(drawn.iter().zip(colour(blur)).all(near), "pixel {i}: V is {blur} px², drawn as {drawn:?}");
    }
    let valid: Vec<f32> = relative_blur.iter().copied().filter(|blur| !blur.is_nan()).collect();
    let [least, most] = [f32::min, f32::max].map(|of| valid.iter().copied().reduce(of).expect("V is valid at a pixel"));
    assert!(least < 0.5 && most > 1.0, "V has too small a range: {least} to {most} px²");
}

/// Writes an RGBA picture as PPM.
///
/// # Errors
/// The file cannot be written.
pub fn write_ppm(path: &str, picture: &[u8]) -> std::io::Result<()> {
    let mut file = format!("P6 {SIZE} {SIZE} 255\n").into_bytes();
    file.extend(picture.chunks_exact(4).flat_map(|pixel| &pixel[..3]));
    std::fs::write(path, file)
}
