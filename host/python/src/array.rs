//! Arrays at the border: read where they lie, never converted behind the caller's back, and checked before anything is computed.

use numpy::{
    Element, Ix1, Ix2, PyArray, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods,
    PyReadonlyArray, PyUntypedArray, PyUntypedArrayMethods, ndarray::Dimension,
};
use pyo3::prelude::*;

use flankscope_metrology::io::cloud::MOST_COORDINATE_MM;

use crate::error::{ArrayError, GeometryError, NotFiniteError};

/// An array of one type, as many axes as `D` and a shape that `fits`, its rows one after the other in memory.
pub fn borrow<'py, T: Element, D: Dimension>(
    name: &str,
    (needed, fits): (&str, impl Fn(&[usize]) -> bool),
    array: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let py = array.py();
    let Ok(untyped) = array.cast::<PyUntypedArray>() else {
        let kind = array.get_type().name()?;
        return Err(ArrayError::new_err(format!(
            "{name} is no NumPy array but {kind}; {needed} is needed"
        )));
    };
    let dtype = untyped.dtype();
    if !dtype.is_equiv_to(&T::get_dtype(py)) {
        let right = T::get_dtype(py);
        return Err(ArrayError::new_err(format!(
            "{name} is of {dtype}; {right} is needed: nothing is converted unasked, {name}.astype(np.{right}) does it"
        )));
    }
    let shape = untyped.shape();
    let Some(typed) = array.cast::<PyArray<T, D>>().ok().filter(|_| fits(shape)) else {
        return Err(ArrayError::new_err(format!(
            "{name} has the shape {shape:?}; {needed} is needed"
        )));
    };
    if !untyped.is_c_contiguous() {
        return Err(ArrayError::new_err(format!(
            "{name} does not lie in one piece row after row (strides {:?}): np.ascontiguousarray({name}) copies it so",
            untyped.strides()
        )));
    }
    if !untyped.is_aligned() {
        return Err(ArrayError::new_err(format!(
            "{name} does not lie at a multiple of its items' size: {name}.copy() does"
        )));
    }
    typed
        .try_readonly()
        .map_err(|_| ArrayError::new_err(format!("{name} is being written to by another call")))
}

/// The values of an array that was borrowed by [`borrow`].
pub fn values<'a, T: Element, D: Dimension>(array: &'a PyReadonlyArray<'_, T, D>) -> &'a [T] {
    array
        .as_slice()
        .expect("aligned and in one piece: checked when it was borrowed")
}

/// Rows of three numbers, borrowed.
pub struct Rows<'py, T: Element>(PyReadonlyArray<'py, T, Ix2>);

impl<'py, T: Element> Rows<'py, T> {
    /// Of an array of shape (n, 3).
    pub fn of(name: &str, array: &Bound<'py, PyAny>) -> PyResult<Self> {
        let shape = ("(n, 3)", |shape: &[usize]| matches!(shape, [_, 3]));
        Ok(Self(borrow::<T, Ix2>(name, shape, array)?))
    }

    /// The rows, where they lie.
    pub fn rows(&self) -> &[[T; 3]] {
        values(&self.0).as_chunks().0
    }
}

/// Points, borrowed: float64, (n, 3), all of them finite and no farther than [`MOST_COORDINATE_MM`].
pub fn points<'py>(name: &str, array: &Bound<'py, PyAny>) -> PyResult<Rows<'py, f64>> {
    let rows = Rows::<f64>::of(name, array)?;
    let all = rows.rows().as_flattened();
    if let Some(at) = all.iter().position(|c| !c.is_finite()) {
        return Err(NotFiniteError::new_err(format!(
            "{name}[{}, {}] is {}; every coordinate must be finite: {name}[np.isfinite({name}).all(axis=1)] leaves such points out",
            at / 3,
            at % 3,
            all[at]
        )));
    }
    if let Some(at) = all.iter().position(|c| c.abs() > MOST_COORDINATE_MM) {
        return Err(GeometryError::new_err(format!(
            "{name}[{}, {}] is {:e} mm; at most {MOST_COORDINATE_MM:e} mm either way is needed",
            at / 3,
            at % 3,
            all[at]
        )));
    }
    Ok(rows)
}

/// Standard uncertainties of points, borrowed: float32, (n), finite and positive.
pub struct Sigmas<'py>(PyReadonlyArray<'py, f32, Ix1>);

impl<'py> Sigmas<'py> {
    /// Of an array, one for each of `count` points.
    pub fn of(array: &Bound<'py, PyAny>, count: usize) -> PyResult<Self> {
        const NAME: &str = "sigma_mm";
        let needed = format!("({count}), one per point,");
        let shape = (needed.as_str(), |shape: &[usize]| shape == [count]);
        let array = borrow::<f32, Ix1>(NAME, shape, array)?;
        let bad = values(&array)
            .iter()
            .enumerate()
            .find(|(_, sigma)| !(sigma.is_finite() && **sigma > 0.0));
        match bad {
            Some((at, sigma)) => Err(NotFiniteError::new_err(format!(
                "sigma_mm[{at}] is {sigma}; every standard uncertainty must be finite and above 0"
            ))),
            None => Ok(Self(array)),
        }
    }

    /// The values, where they lie.
    pub fn values(&self) -> &[f32] {
        values(&self.0)
    }
}

/// A list of values as an array, moved.
pub fn list<T: Element>(py: Python<'_>, values: Vec<T>) -> Py<PyArray1<T>> {
    PyArray1::from_vec(py, values).unbind()
}

/// Values as an array of some shape, moved.
pub fn shaped<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Py<PyArrayDyn<T>>> {
    let shaped = PyArray1::from_vec(py, values).reshape(shape.to_vec())?;
    Ok(shaped.unbind())
}

/// Points as an array of shape (n, 3), moved.
pub fn from_points(py: Python<'_>, points: Vec<[f64; 3]>) -> PyResult<Py<PyArrayDyn<f64>>> {
    let count = points.len();
    shaped(py, points.into_flattened(), &[count, 3])
}

/// A pose as an array of shape (4, 4).
pub fn from_pose(py: Python<'_>, rows: [[f64; 4]; 4]) -> PyResult<Py<PyArrayDyn<f64>>> {
    shaped(py, rows.as_flattened().to_vec(), &[4, 4])
}

/// A pose: float64, (4, 4).
pub fn pose(name: &str, array: &Bound<'_, PyAny>) -> PyResult<[[f64; 4]; 4]> {
    let shape = ("(4, 4)", |shape: &[usize]| shape == [4, 4]);
    let array = borrow::<f64, Ix2>(name, shape, array)?;
    let mut pose = [[0.0; 4]; 4];
    for (to, from) in pose.as_flattened_mut().iter_mut().zip(values(&array)) {
        *to = *from;
    }
    Ok(pose)
}
