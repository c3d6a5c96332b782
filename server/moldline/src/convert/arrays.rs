//! Arrays of the protocol: little-endian bytes with type and shape. Reading one checks its type, its shape and its length before
//! memory is taken; errors name the array's field.

use moldline_host::ServiceError;
use moldline_proto::v1::{self, DataType};

/// An array of points: (n, 3).
pub fn points(points: &[[f64; 3]]) -> v1::Array {
    numbers(&[points.len(), 3], [points.as_flattened()])
}

/// An array of the elements of `parts`, one part after the other.
pub fn numbers<'a>(shape: &[usize], parts: impl IntoIterator<Item = &'a [f64]>) -> v1::Array {
    let mut data = Vec::with_capacity(size_of::<f64>() * shape.iter().product::<usize>());
    for part in parts {
        if cfg!(target_endian = "little") {
            data.extend_from_slice(bytemuck::cast_slice(part));
        } else {
            part.iter().for_each(|value| data.extend_from_slice(&value.to_le_bytes()));
        }
    }
    array(DataType::Float64, shape, data)
}

/// An array of indices.
pub fn index_array(shape: &[usize], indices: &[u32]) -> v1::Array {
    array(DataType::Uint32, shape, indices.iter().flat_map(|index| index.to_le_bytes()).collect())
}

/// An array of the elements in `data`, little-endian.
pub fn array(dtype: DataType, shape: &[usize], data: Vec<u8>) -> v1::Array {
    let shape = shape.iter().map(|&extent| extent as u64).collect();
    v1::Array { dtype: dtype.into(), shape, data: data.into() }
}

/// The `N` extents of an array of 8-byte elements, after a check that its data fill them.
pub fn shape<const N: usize>(field: &str, array: &v1::Array) -> Result<[u64; N], ServiceError> {
    extents(field, array, size_of::<f64>() as u64)
}

/// The same for elements of any size in bytes.
fn extents<const N: usize>(field: &str, array: &v1::Array, element: u64) -> Result<[u64; N], ServiceError> {
    let shape: [u64; N] = array.shape.as_slice().try_into().map_err(|_| {
        let found = array.shape.len();
        ServiceError::invalid(format!("{field}.shape"), format!("{found} dimensions, expected {N}"))
    })?;
    let bytes = shape.iter().try_fold(element, |bytes, &extent| bytes.checked_mul(extent));
    if bytes != Some(array.data.len() as u64) {
        return Err(ServiceError::invalid(
            format!("{field}.data"),
            format!("{} bytes do not fill the shape {shape:?} of {element}-byte elements", array.data.len()),
        ));
    }
    Ok(shape)
}

/// Rows of `C` indices each.
pub fn index_rows<const C: usize>(field: &str, array: &v1::Array) -> Result<Vec<[u32; C]>, ServiceError> {
    let [_, columns] = extents(field, array, size_of::<u32>() as u64)?;
    if columns != C as u64 {
        return Err(ServiceError::invalid(format!("{field}.shape[1]"), format!("{columns} is not {C}")));
    }
    let flat = read_indices(field, array)?;
    Ok(flat.as_chunks::<C>().0.to_vec())
}

/// A list of indices.
pub fn indices(field: &str, array: &v1::Array) -> Result<Vec<u32>, ServiceError> {
    let [_] = extents(field, array, size_of::<u32>() as u64)?;
    read_indices(field, array)
}

fn read_indices(field: &str, array: &v1::Array) -> Result<Vec<u32>, ServiceError> {
    if array.dtype() != DataType::Uint32 {
        return Err(ServiceError::invalid(
            format!("{field}.dtype"),
            format!("{} is not DATA_TYPE_UINT32", array.dtype().as_str_name()),
        ));
    }
    Ok(array.data.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect())
}

/// Positions: (n, 3).
pub fn positions(field: &str, array: &v1::Array) -> Result<Vec<[f64; 3]>, ServiceError> {
    let [_, columns] = shape(field, array)?;
    if columns != 3 {
        return Err(ServiceError::invalid(format!("{field}.shape[1]"), format!("{columns} is not 3")));
    }
    check_float64(field, array)?;
    Ok(of_points(&array.data))
}

fn check_float64(field: &str, array: &v1::Array) -> Result<(), ServiceError> {
    if array.dtype() != DataType::Float64 {
        return Err(ServiceError::invalid(
            format!("{field}.dtype"),
            format!("{} is not DATA_TYPE_FLOAT64", array.dtype().as_str_name()),
        ));
    }
    Ok(())
}

/// Little-endian numbers of any alignment, one by one or in points.
fn elements<T: bytemuck::Pod>(bytes: &[u8], swap: impl Fn(&mut T)) -> Vec<T> {
    let mut elements = vec![T::zeroed(); bytes.len() / size_of::<T>()];
    let filled = size_of_val(&elements[..]);
    bytemuck::cast_slice_mut(&mut elements).copy_from_slice(&bytes[..filled]);
    if cfg!(target_endian = "big") {
        elements.iter_mut().for_each(swap);
    }
    elements
}

fn of_numbers(bytes: &[u8]) -> Vec<f64> {
    elements(bytes, |number: &mut f64| *number = f64::from_bits(number.to_bits().swap_bytes()))
}

fn of_points(bytes: &[u8]) -> Vec<[f64; 3]> {
    elements(bytes, |point: &mut [f64; 3]| {
        point.iter_mut().for_each(|number| *number = f64::from_bits(number.to_bits().swap_bytes()));
    })
}

/// The elements of an array of any shape.
pub fn float64(field: &str, array: &v1::Array) -> Result<Vec<f64>, ServiceError> {
    check_float64(field, array)?;
    Ok(of_numbers(&array.data))
}

/// Vectors of numbers: (k, length).
pub fn vectors(field: &str, array: &v1::Array) -> Result<Vec<Vec<f64>>, ServiceError> {
    let [_, length] = filled(field, array)?;
    check_float64(field, array)?;
    Ok(array.data.chunks_exact(size_of::<f64>() * length).map(of_numbers).collect())
}

/// Vectors of points: (k, length, 3).
pub fn point_vectors(field: &str, array: &v1::Array) -> Result<Vec<Vec<[f64; 3]>>, ServiceError> {
    let [_, length, columns] = filled(field, array)?;
    if columns != 3 {
        return Err(ServiceError::invalid(format!("{field}.shape[2]"), format!("{columns} is not 3")));
    }
    check_float64(field, array)?;
    Ok(array.data.chunks_exact(size_of::<[f64; 3]>() * length).map(of_points).collect())
}

/// The extents, after a check that none is zero.
fn filled<const N: usize>(field: &str, array: &v1::Array) -> Result<[usize; N], ServiceError> {
    let shape = shape(field, array)?;
    match shape.iter().position(|&extent| extent == 0) {
        Some(axis) => Err(ServiceError::invalid(format!("{field}.shape[{axis}]"), "0 is not positive")),
        // The data have a byte for each element at least, so extents fit.
        None => Ok(shape.map(|extent| extent as usize)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_little_endian_rows() {
        let array = points(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(array.shape, [2, 3]);
        assert_eq!(array.data[8..16], 2.0_f64.to_le_bytes());
    }
}
