//! Blocks of vectors, cut into pieces that fit one request.

use std::ops::Range;

use moldline_proto::v1;

use crate::{Error, Point, convert};

/// Vectors and bytes of one request, within the server's usual limits; larger blocks go in several requests.
const MOST_VECTORS: usize = 64;
const MOST_BYTES: usize = 32 << 20;

/// One entry of a vector: a number, or numbers along an axis of their own.
pub trait Entry: Sized {
    /// Extent of that axis.
    const AXIS: Option<usize>;

    fn numbers(entries: &[Self]) -> Vec<f64>;
}

impl Entry for f64 {
    const AXIS: Option<usize> = None;

    fn numbers(entries: &[Self]) -> Vec<f64> {
        entries.to_vec()
    }
}

impl Entry for Point {
    const AXIS: Option<usize> = Some(3);

    fn numbers(entries: &[Self]) -> Vec<f64> {
        entries.as_flattened().to_vec()
    }
}

/// Ranges of vectors that fit one request, where a vector has as many numbers as `points` points.
pub fn pieces(
    points: usize,
    count: usize,
) -> Result<impl Iterator<Item = Range<usize>> + Send + use<>, Error> {
    if count == 0 {
        return Err(Error::client("there is nothing to multiply with: `count` is 0"));
    }
    let step = (MOST_BYTES / (size_of::<Point>() * points.max(1))).clamp(1, MOST_VECTORS);
    Ok((0..count).step_by(step).map(move |first| first..count.min(first + step)))
}

/// A piece of `count` vectors of the same length, (piece, length, ...); nothing if there are no values.
pub fn vectors<T: Entry>(
    values: &[T],
    count: usize,
    piece: &Range<usize>,
    name: &str,
) -> Result<Option<v1::Array>, Error> {
    if !values.len().is_multiple_of(count) {
        return Err(Error::client(format!(
            "{name} has {} entries, which are not {count} vectors of the same length",
            values.len()
        )));
    }
    let length = values.len() / count;
    Ok((length > 0).then(|| array(&values[piece.start * length..piece.end * length], &[piece.len(), length])))
}

/// A piece of `count` entries, (piece, ...); nothing if there are no values.
pub fn entries<T: Entry>(
    values: &[T],
    count: usize,
    piece: &Range<usize>,
    name: &str,
) -> Result<Option<v1::Array>, Error> {
    if values.is_empty() {
        return Ok(None);
    }
    if values.len() != count {
        let message =
            format!("{name} has {} entries; there is one for each of {count} vectors", values.len());
        return Err(Error::client(message));
    }
    Ok(Some(array(&values[piece.clone()], &[piece.len()])))
}

fn array<T: Entry>(entries: &[T], shape: &[usize]) -> v1::Array {
    let shape: Vec<usize> = shape.iter().copied().chain(T::AXIS).collect();
    convert::array(&T::numbers(entries), &shape)
}
