//! NumPy's file formats: .npy for one array, .npz for several.
//!
//! A .npy file is `\x93NUMPY`, a version, the length of a header, the header (a Python dictionary with `descr`,
//! `fortran_order` and `shape`), and the elements. A .npz file is a zip archive of .npy files.

use std::io::{Cursor, Read, Write};

use bytes::Bytes;
use moldline_host::{ServiceError, shorten};
use moldline_proto::v1::{Array, DataType};
use zip::{CompressionMethod, ZipArchive, ZipWriter, write::SimpleFileOptions};

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Longest accepted header; ours and numpy's are a fiftieth of it.
const HEADER: usize = 10_000;
/// Most accepted dimensions.
const DIMENSIONS: usize = 8;
/// Most accepted arrays in a .npz file.
const MEMBERS: usize = 1000;

/// The bytes that precede the elements of an array of that shape.
pub fn header(dtype: DataType, shape: &[u64]) -> Vec<u8> {
    let descr = match dtype {
        DataType::Uint32 => "<u4",
        DataType::Uint8 => "|u1",
        DataType::Float64 | DataType::Unspecified => "<f8",
    };
    let extents: String = shape.iter().map(|extent| format!("{extent}, ")).collect();
    // A tuple of one element keeps its comma.
    let extents = if shape.len() == 1 { extents.trim_end() } else { extents.trim_end_matches(", ") };
    let mut dictionary = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({extents}), }}");
    // The elements start at a multiple of 64 bytes.
    const FIXED: usize = MAGIC.len() + 4;
    let end = (FIXED + dictionary.len() + 1).next_multiple_of(64);
    dictionary.extend(std::iter::repeat_n(' ', end - FIXED - dictionary.len() - 1));
    dictionary.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((dictionary.len() as u16).to_le_bytes());
    bytes.extend(dictionary.as_bytes());
    bytes
}

/// Reads a .npy file of float64 in C order, the only kind accepted in requests. The elements are not copied.
///
/// # Errors
/// `InvalidArgument` for `field`: not a .npy file, another type or order, or a number of elements that differs from the shape.
pub fn read(field: &str, file: &Bytes) -> Result<Array, ServiceError> {
    let wrong =
        |what: &str| ServiceError::invalid(field, format!("is not a .npy file that can be read: {what}"));
    let rest = file.strip_prefix(MAGIC).ok_or_else(|| wrong("it does not begin with \\x93NUMPY"))?;
    let (length, start) = match *rest {
        [1, _, a, b, ..] => (usize::from(u16::from_le_bytes([a, b])), 10),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]) as usize, 12),
        _ => return Err(wrong("its version is not 1, 2 or 3")),
    };
    if length > HEADER {
        return Err(wrong(&format!("a header of {length} bytes is longer than the limit of {HEADER}")));
    }
    let header = file.get(start..start + length).ok_or_else(|| wrong("its header is cut off"))?;
    let header = std::str::from_utf8(header).map_err(|_| wrong("its header is not text"))?;
    let Header { descr, fortran_order, shape } = parse(header).map_err(wrong)?;
    if descr != "<f8" {
        return Err(ServiceError::invalid(
            format!("{field}.dtype"),
            format!("`{descr}` is not little-endian float64; save `array.astype(\"<f8\")`"),
        ));
    }
    if fortran_order {
        let description = "is in Fortran order; save `numpy.ascontiguousarray(array)`";
        return Err(ServiceError::invalid(field, description));
    }
    let data = file.slice(start + length..);
    let bytes = shape.iter().try_fold(8_u64, |bytes, &extent| bytes.checked_mul(extent));
    if bytes != Some(data.len() as u64) {
        return Err(ServiceError::invalid(
            field,
            format!("{} bytes do not fill the shape {shape:?} of 8-byte elements", data.len()),
        ));
    }
    Ok(Array { dtype: DataType::Float64.into(), shape, data })
}

struct Header<'a> {
    descr: &'a str,
    fortran_order: bool,
    shape: Vec<u64>,
}

/// Parses the header's dictionary: the three keys in any order.
fn parse(text: &str) -> Result<Header<'_>, &'static str> {
    let (mut descr, mut fortran_order, mut shape) = (None, None, None);
    let text = text.trim();
    let mut rest = text
        .strip_prefix('{')
        .and_then(|text| text.strip_suffix('}'))
        .ok_or("its header is not a dictionary")?
        .trim_start();
    while !rest.is_empty() {
        let (key, after) = quoted(rest).ok_or("its header has a key that is not a string")?;
        rest = after.trim_start().strip_prefix(':').ok_or("its header has a key without value")?.trim_start();
        rest = match key {
            "descr" => {
                let (value, after) = quoted(rest).ok_or("its elements are not of one plain type")?;
                descr = Some(value);
                after
            }
            "fortran_order" => {
                let known = [("True", true), ("False", false)];
                let found = known.iter().find_map(|&(word, value)| Some((value, rest.strip_prefix(word)?)));
                let (value, after) = found.ok_or("`fortran_order` is not True or False")?;
                fortran_order = Some(value);
                after
            }
            "shape" => {
                let inner = rest.strip_prefix('(').and_then(|rest| rest.split_once(')'));
                let (inner, after) = inner.ok_or("`shape` is not a tuple")?;
                shape = Some(extents(inner)?);
                after
            }
            _ => return Err("its header has a key other than descr, fortran_order and shape"),
        };
        rest = rest.trim_start();
        rest = match rest.strip_prefix(',') {
            Some(after) => after.trim_start(),
            None if rest.is_empty() => rest,
            None => return Err("its header lacks a comma"),
        };
    }
    match (descr, fortran_order, shape) {
        (Some(descr), Some(fortran_order), Some(shape)) => Ok(Header { descr, fortran_order, shape }),
        _ => Err("its header lacks one of descr, fortran_order and shape"),
    }
}

/// A quoted string without escapes, and the text after it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|quote| matches!(quote, '\'' | '"'))?;
    text[1..].split_once(quote)
}

fn extents(inner: &str) -> Result<Vec<u64>, &'static str> {
    let mut parts: Vec<&str> = inner.split(',').map(str::trim).collect();
    if parts.last() == Some(&"") {
        parts.pop();
    }
    if parts.len() > DIMENSIONS {
        return Err("`shape` has more than eight dimensions");
    }
    let extents = parts.into_iter().map(|part| part.trim_end_matches('L').parse());
    extents.collect::<Result<_, _>>().map_err(|_| "`shape` has an extent that is not a number")
}

/// An uncompressed .npz file: arrays by name, and a text file `info.json`.
///
/// # Errors
/// If the archive cannot hold them.
pub fn write_npz(arrays: &[(String, Array)], info: &str) -> Result<Vec<u8>, ServiceError> {
    let failed = |error: &dyn std::error::Error| {
        ServiceError::new(moldline_host::Code::Internal, format!("cannot make the .npz file: {error}"))
    };
    let bytes = arrays.iter().map(|(_, array)| array.data.len() + 512).sum::<usize>();
    let mut archive = ZipWriter::new(Cursor::new(Vec::with_capacity(bytes + info.len())));
    let options = |length: usize| {
        SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .large_file(length >= u32::MAX as usize)
    };
    for (name, array) in arrays {
        let data = options(array.data.len());
        archive.start_file(format!("{name}.npy"), data).map_err(|error| failed(&error))?;
        archive.write_all(&header(array.dtype(), &array.shape)).map_err(|error| failed(&error))?;
        archive.write_all(&array.data).map_err(|error| failed(&error))?;
    }
    archive.start_file("info.json", options(info.len())).map_err(|error| failed(&error))?;
    archive.write_all(info.as_bytes()).map_err(|error| failed(&error))?;
    Ok(archive.finish().map_err(|error| failed(&error))?.into_inner())
}

/// Reads a .npz file, compressed or not, that unpacks to `limit` bytes at most.
///
/// # Errors
/// `InvalidArgument` naming the array.
pub fn read_npz(file: Bytes, limit: usize) -> Result<Vec<(String, Array)>, ServiceError> {
    let unreadable = |error| ServiceError::invalid("body", format!("is not a .npz file: {error}"));
    // Before the directory is read, whose entries take several times their bytes.
    let entries = file.windows(4).filter(|bytes| bytes == b"PK\x01\x02").count();
    if entries > 4 * MEMBERS {
        let limit = format!("{entries} arrays are more than the limit of {MEMBERS}");
        return Err(ServiceError::invalid("body", limit));
    }
    let mut archive = ZipArchive::new(Cursor::new(file)).map_err(unreadable)?;
    if archive.len() > MEMBERS {
        let count = archive.len();
        return Err(ServiceError::invalid(
            "body",
            format!("{count} arrays are more than the limit of {MEMBERS}"),
        ));
    }
    let mut left = limit as u64;
    let mut arrays: Vec<(String, Array)> = Vec::with_capacity(archive.len());
    for index in 0..archive.len() {
        let member = archive.by_index(index).map_err(unreadable)?;
        let name = member.name().map_err(unreadable)?.into_owned();
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else {
            let name: String = name.chars().take(64).collect();
            return Err(ServiceError::invalid("body", format!("`{name}` in it is not a .npy file")));
        };
        if arrays.iter().any(|(known, _)| *known == name) {
            let twice = "occurs twice in the .npz file; give each array a name of its own";
            return Err(ServiceError::invalid(shorten(&name), twice));
        }
        // The size in the directory may be false: reading stops at the limit.
        let mut data = Vec::with_capacity(member.size().min(left) as usize);
        let read = member.take(left + 1).read_to_end(&mut data);
        read.map_err(|error| ServiceError::invalid(&name, format!("cannot be unpacked: {error}")))?;
        left = left.checked_sub(data.len() as u64).ok_or_else(|| {
            ServiceError::invalid("body", format!("unpacks to more than the limit of {limit} bytes"))
        })?;
        arrays.push((name.clone(), self::read(&name, &data.into())?));
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, data: &[u8]) -> Bytes {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes.into()
    }

    fn numbers(shape: &[u64]) -> Array {
        let count: u64 = shape.iter().product();
        let data: Vec<u8> = (0..count).flat_map(|i| (i as f64 + 0.5).to_le_bytes()).collect();
        Array { dtype: DataType::Float64.into(), shape: shape.to_vec(), data: data.into() }
    }

    #[test]
    fn headers_are_those_that_numpy_writes() {
        // From numpy.lib.format.header_data_from_array_1_0 and write_array_header_1_0 of numpy 2.
        let mut expected =
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }".to_vec();
        expected.resize(127, b' ');
        expected.push(b'\n');
        assert_eq!(header(DataType::Float64, &[3]), expected);
        let text =
            |shape: &[u64]| String::from_utf8_lossy(&header(DataType::Uint8, shape)[10..]).trim().to_owned();
        assert_eq!(text(&[]), "{'descr': '|u1', 'fortran_order': False, 'shape': (), }");
        assert_eq!(text(&[2, 3]), "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 3), }");
    }

    #[test]
    fn written_arrays_are_read_back() {
        for shape in [&[][..], &[0], &[7], &[2, 3], &[1, 2, 3], &[1, 1, 1, 1, 1, 1, 1, 2]] {
            let array = numbers(shape);
            let bytes = [header(DataType::Float64, shape), array.data.to_vec()].concat();
            assert_eq!(read("x", &bytes.into()).unwrap(), array);
        }
        let arrays =
            vec![("a".to_owned(), numbers(&[2, 3])), ("control_points.wing".to_owned(), numbers(&[4]))];
        let packed = Bytes::from(write_npz(&arrays, "{}").unwrap());
        // `info.json` is for people, and not accepted in requests.
        let error = read_npz(packed.clone(), 1 << 20).unwrap_err();
        assert!(error.message.contains("info.json"), "{error}");
        let mut archive = ZipArchive::new(Cursor::new(packed)).unwrap();
        for (name, array) in arrays {
            let mut bytes = Vec::new();
            archive.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
            assert_eq!(read("x", &bytes.into()).unwrap(), array);
        }
    }

    #[test]
    fn invalid_headers_are_rejected() {
        let field = |bytes: Bytes| read("x", &bytes).unwrap_err().violations[0].field.clone();
        let data = [0_u8; 16];
        let good = "{'descr': '<f8', 'fortran_order': False, 'shape': (2,)}";
        assert!(read("x", &file(good, &data)).is_ok());
        assert!(
            read("x", &file("{\"shape\":(2L,),\"fortran_order\":False,\"descr\":\"<f8\"}", &data)).is_ok()
        );
        assert_eq!(field(file(&good.replace("<f8", ">f8"), &data)), "x.dtype");
        assert_eq!(field(file(&good.replace("<f8", "<f4"), &data)), "x.dtype");
        for header in [
            good.replace("False", "True"),
            good.replace("(2,)", "(3,)"),
            good.replace("(2,)", "(-2,)"),
            good.replace("(2,)", "(2305843009213693954,)"),
            good.replace("(2,)", "(4294967296, 4294967296, 4294967296)"),
            good.replace("(2,)", "(1,1,1,1,1,1,1,1,2)"),
            good.replace("(2,)", "2"),
            good.replace("'shape'", "'form'"),
            good.replace("'descr': '<f8'", "'descr': [('a', '<f8')]"),
            good.replace(", 'shape': (2,)", ""),
            good.replace("}", ""),
            "{'descr'".to_owned(),
            "{é".to_owned(),
            "{}".to_owned(),
            String::new(),
        ] {
            assert_eq!(field(file(&header, &data)), "x", "{header}");
        }
        for cut in 0..10 + good.len() {
            assert_eq!(field(file(good, &data).slice(..cut)), "x", "{cut}");
        }
        assert_eq!(field(Bytes::from_static(b"\x93NUMPY\x02\x00\xff\xff\xff\xff")), "x");
        assert_eq!(field(Bytes::from_static(b"\x93NUMPY\x09\x00\x00\x00")), "x");
    }

    #[test]
    fn archives_beyond_the_limit_are_rejected() {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
        archive.start_file("design.npy", options).unwrap();
        archive.write_all(&header(DataType::Float64, &[1 << 17])).unwrap();
        archive.write_all(&vec![0; 1 << 20]).unwrap();
        let packed: Bytes = archive.finish().unwrap().into_inner().into();
        assert!(packed.len() < 10_000);
        let unpacked = read_npz(packed.clone(), (1 << 20) + 128).unwrap();
        assert_eq!(unpacked[0].0, "design");
        assert_eq!(unpacked[0].1.shape, [1 << 17]);
        let error = read_npz(packed, 1 << 20).unwrap_err();
        assert!(error.message.contains("1048576"), "{error}");
        assert!(read_npz(Bytes::from_static(b"PK"), 100).is_err());
    }
}
