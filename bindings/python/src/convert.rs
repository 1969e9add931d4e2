//! Conversion of NumPy arrays to frames and back. Fields become arrays without a copy.

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{Element, IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use parfocal::{
    Frame, Mask, Region,
    frame::{Channels, Samples},
    transform::Homography,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Copies an array to a frame.
pub(crate) fn frame(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Frame> {
    if let Ok(array) = array.cast::<PyArrayDyn<u8>>() {
        return typed_frame(&array.readonly(), name, Samples::U8);
    }
    if let Ok(array) = array.cast::<PyArrayDyn<u16>>() {
        return typed_frame(&array.readonly(), name, Samples::U16);
    }
    if let Ok(array) = array.cast::<PyArrayDyn<f32>>() {
        return typed_frame(&array.readonly(), name, Samples::F32);
    }
    let kind =
        array.getattr("dtype").and_then(|dtype| dtype.str()).map_or_else(|_| "no numbers".into(), |s| s.to_string());
    Err(PyTypeError::new_err(format!(
        "{name} holds {kind}: convert it to uint8, uint16 or floats, whose white is 255, 65535 or 1"
    )))
}

fn typed_frame<T: Element + Copy>(
    array: &PyReadonlyArrayDyn<'_, T>,
    name: &str,
    samples: fn(Vec<T>) -> Samples,
) -> PyResult<Frame> {
    let wrong = |problem: String| PyValueError::new_err(format!("{name}: {problem}"));
    let (height, width, channels) = match *array.shape() {
        [height, width] | [height, width, 1] => (height, width, Channels::Gray),
        [height, width, 3] => (height, width, Channels::Rgb),
        [_, _, 2 | 4] => return Err(wrong("remove the alpha channel: image[..., :-1]".to_string())),
        ref shape => {
            let shape = shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            return Err(wrong(format!("its shape is ({shape}); give (height, width) or (height, width, 3)")));
        }
    };
    let side = |n: usize| u32::try_from(n).map_err(|_| wrong(format!("{width}x{height} pixels are too many")));
    // The interpreter's lock is held, so no other thread writes meanwhile. `as_slice` has the order of memory, which may be
    // column-major.
    let rows = array.as_slice().ok().filter(|_| array.is_c_contiguous());
    let copied = rows.map_or_else(|| array.as_array().iter().copied().collect(), <[T]>::to_vec);
    Frame::new(side(width)?, side(height)?, channels, samples(copied)).map_err(wrong)
}

/// Converts a frame to an array.
pub(crate) fn array_of(py: Python<'_>, frame: &Frame) -> PyResult<Py<PyAny>> {
    let size = [frame.width(), frame.height()];
    match (frame.samples().clone(), frame.format().channels) {
        (Samples::U8(s), channels) => image(py, s, size, channels),
        (Samples::U16(s), channels) => image(py, s, size, channels),
        (Samples::F32(s), channels) => image(py, s, size, channels),
    }
}

/// Converts interleaved samples to an array of height x width, or height x width x 3.
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

/// Converts a field, one value per pixel, to an array of height x width.
pub(crate) fn field<T: Element>(py: Python<'_>, values: Vec<T>, [width, height]: [u32; 2]) -> PyResult<Py<PyAny>> {
    let shape = (height as usize, width as usize);
    Ok(shaped(Array2::from_shape_vec(shape, values))?.into_pyarray(py).into_any().unbind())
}

/// Converts values to an array of one dimension.
pub(crate) fn row<T: Element>(py: Python<'_>, values: Vec<T>) -> Py<PyAny> {
    Array1::from_vec(values).into_pyarray(py).into_any().unbind()
}

fn shaped<T>(made: Result<T, numpy::ndarray::ShapeError>) -> PyResult<T> {
    made.map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Converts T to a 3x3 array.
pub(crate) fn matrix(py: Python<'_>, t: &Homography) -> PyResult<Py<PyAny>> {
    field(py, t.matrix().as_flattened().to_vec(), [3, 3])
}

/// Makes T from a matrix, row by row.
pub(crate) fn homography(rows: [[f64; 3]; 3]) -> PyResult<Homography> {
    Homography::from_matrix(rows)
        .ok_or_else(|| PyValueError::new_err("the transform is not invertible, mirrors, or is not finite"))
}

/// Makes a region from x, y, width and height, px.
pub(crate) fn region([x, y, width, height]: [u32; 4]) -> Region {
    Region { x, y, width, height }
}

/// Makes a mask of the pixels that are not 0.
pub(crate) fn mask(array: &Bound<'_, PyAny>) -> PyResult<Mask> {
    Ok(Mask::from_image(&frame(array, "mask")?))
}
