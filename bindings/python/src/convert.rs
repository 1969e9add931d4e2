//! Arrays of NumPy's to frames and back; fields go out over the memory that they are in.

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{Element, IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use parfocal::{
    Frame, Mask, Region,
    frame::{Channels, Samples},
    transform::Homography,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// A photograph, copied.
pub(crate) fn frame(of: &Bound<'_, PyAny>, name: &str) -> PyResult<Frame> {
    if let Ok(array) = of.cast::<PyArrayDyn<u8>>() {
        return framed(&array.readonly(), name, Samples::U8);
    }
    if let Ok(array) = of.cast::<PyArrayDyn<u16>>() {
        return framed(&array.readonly(), name, Samples::U16);
    }
    if let Ok(array) = of.cast::<PyArrayDyn<f32>>() {
        return framed(&array.readonly(), name, Samples::F32);
    }
    let kind =
        of.getattr("dtype").and_then(|dtype| dtype.str()).map_or_else(|_| "no numbers".into(), |s| s.to_string());
    Err(PyTypeError::new_err(format!(
        "{name} holds {kind}: convert it to uint8, uint16 or float32, whose white is 255, 65535 or 1"
    )))
}

fn framed<T: Element + Copy>(
    array: &PyReadonlyArrayDyn<'_, T>,
    name: &str,
    samples: fn(Vec<T>) -> Samples,
) -> PyResult<Frame> {
    let wrong = |problem: String| PyValueError::new_err(format!("{name}: {problem}"));
    let (height, width, channels) = match *array.shape() {
        [height, width] | [height, width, 1] => (height, width, Channels::Gray),
        [height, width, 3] => (height, width, Channels::Rgb),
        [_, _, 2 | 4] => return Err(wrong("leave out alpha: image[..., :-1]".to_string())),
        ref shape => {
            return Err(wrong(format!("its shape is {shape:?}, and must be (height, width) or (height, width, 3)")));
        }
    };
    let side = |n: usize| u32::try_from(n).map_err(|_| wrong(format!("{width}x{height} pixels are too many")));
    // Under the interpreter's lock, so that nobody writes meanwhile.
    // `as_slice` is in the order of memory, which may be that of columns.
    let rows = array.as_slice().ok().filter(|_| array.is_c_contiguous());
    let copied = rows.map_or_else(|| array.as_array().iter().copied().collect(), <[T]>::to_vec);
    Frame::new(side(width)?, side(height)?, channels, samples(copied)).map_err(wrong)
}

/// A photograph as an array.
pub(crate) fn array_of(py: Python<'_>, frame: &Frame) -> PyResult<Py<PyAny>> {
    let size = [frame.width(), frame.height()];
    match (frame.samples().clone(), frame.format().channels) {
        (Samples::U8(s), channels) => image(py, s, size, channels),
        (Samples::U16(s), channels) => image(py, s, size, channels),
        (Samples::F32(s), channels) => image(py, s, size, channels),
    }
}

/// Interleaved samples: height x width, or height x width x 3.
pub(crate) fn image<T: Element>(
    py: Python<'_>,
    samples: Vec<T>,
    size: [u32; 2],
    channels: Channels,
) -> PyResult<Py<PyAny>> {
    let [width, height] = size.map(|side| side as usize);
    match channels {
        Channels::Gray => field(py, samples, size),
        Channels::Rgb => {
            Ok(shaped(Array3::from_shape_vec((height, width, 3), samples))?.into_pyarray(py).into_any().unbind())
        }
    }
}

/// A value a pixel.
pub(crate) fn field<T: Element>(py: Python<'_>, values: Vec<T>, [width, height]: [u32; 2]) -> PyResult<Py<PyAny>> {
    let shape = (height as usize, width as usize);
    Ok(shaped(Array2::from_shape_vec(shape, values))?.into_pyarray(py).into_any().unbind())
}

/// Values in a row.
pub(crate) fn row<T: Element>(py: Python<'_>, values: Vec<T>) -> Py<PyAny> {
    Array1::from_vec(values).into_pyarray(py).into_any().unbind()
}

fn shaped<T>(made: Result<T, numpy::ndarray::ShapeError>) -> PyResult<T> {
    made.map_err(|e| PyValueError::new_err(e.to_string()))
}

/// T as a 3x3 array.
pub(crate) fn matrix(py: Python<'_>, t: &Homography) -> PyResult<Py<PyAny>> {
    field(py, t.matrix().as_flattened().to_vec(), [3, 3])
}

/// T from rows.
pub(crate) fn homography(rows: [[f64; 3]; 3]) -> PyResult<Homography> {
    Homography::from_matrix(rows)
        .ok_or_else(|| PyValueError::new_err("the transform has no inverse, mirrors, or is not of finite numbers"))
}

/// X, y, width, height.
pub(crate) fn region([x, y, width, height]: [u32; 4]) -> Region {
    Region { x, y, width, height }
}

/// The pixels that are not 0.
pub(crate) fn mask(of: &Bound<'_, PyAny>) -> PyResult<Mask> {
    Ok(Mask::from_image(&frame(of, "mask")?))
}
