//! The encodings of data arrays: text, base64 and raw bytes, compressed or not.

use std::{borrow::Cow, cell::Cell, io::Read};

use super::xml::{Scanner, Tag};
use crate::io::{
    Place, ReadError,
    cursor::{Cursor, line_of},
    looked_at,
};

/// Largest ratio of an array's bytes to those of the file: the limit of deflate is 1032.
pub(super) const MOST_PER_BYTE: usize = 1040;

/// A `DataArray`'s tag, and its text if the data are inline.
pub(super) struct ArrayTag<'a> {
    kind: Cow<'a, str>,
    format: Format<'a>,
    start: usize,
}

enum Format<'a> {
    Ascii { text: &'a [u8] },
    Binary { text: &'a [u8] },
    Appended { offset: usize },
}

impl<'a> ArrayTag<'a> {
    /// Takes the text after the tag from the scanner.
    pub(super) fn new(tag: &Tag<'a>, scanner: &mut Scanner<'a>) -> Result<Self, ReadError> {
        let kind = tag.attribute("type").ok_or_else(|| tag.without("the attribute `type`"))?;
        let mut text = || if tag.empty { &[][..] } else { scanner.text() };
        let format = match tag.attribute("format").as_deref() {
            Some("ascii") | None => Format::Ascii { text: text() },
            Some("binary") => Format::Binary { text: text() },
            Some("appended") => Format::Appended { offset: tag.required("offset")? },
            Some(_) => return Err(tag.without("the format ascii, binary or appended")),
        };
        Ok(Self { kind, format, start: tag.start })
    }
}

/// Properties of all arrays of a file.
pub(super) struct File<'a> {
    pub(super) bytes: &'a [u8],
    little_endian: bool,
    header_bytes: usize,
    pub(super) compressed: bool,
    /// The appended data behind their underscore, and whether they are base64.
    appended: Option<(&'a [u8], bool)>,
    /// Bytes of appended data that arrays have taken.
    taken: Cell<usize>,
}

impl<'a> File<'a> {
    pub(super) fn new(bytes: &'a [u8], tag: &Tag<'a>) -> Result<Self, ReadError> {
        let unsupported = |what: &str, value: &str, advice| {
            let place = line_of(bytes, tag.start);
            Err(ReadError::Unsupported { place, what: format!("{what} {value}"), advice })
        };
        if let Some(kind) = tag.attribute("type").filter(|kind| kind != "UnstructuredGrid") {
            return unsupported("file type", &kind, "write an UnstructuredGrid");
        }
        let little_endian = match tag.attribute("byte_order").as_deref() {
            Some("LittleEndian") | None => true,
            Some("BigEndian") => false,
            Some(other) => return unsupported("byte order", other, "write LittleEndian or BigEndian"),
        };
        let header_bytes = match tag.attribute("header_type").as_deref() {
            Some("UInt32") | None => 4,
            Some("UInt64") => 8,
            Some(other) => return unsupported("header type", other, "write UInt32 or UInt64"),
        };
        let compressed = match tag.attribute("compressor").as_deref() {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => return unsupported("compressor", other, "write with zlib or uncompressed"),
        };
        Ok(Self { bytes, little_endian, header_bytes, compressed, appended: None, taken: Cell::new(0) })
    }

    pub(super) fn note_appended(&mut self, tag: &Tag<'a>) -> Result<(), ReadError> {
        let base64 = match tag.attribute("encoding").as_deref() {
            Some("base64") => true,
            Some("raw") => false,
            _ => return Err(tag.without("the encoding base64 or raw")),
        };
        let rest = &self.bytes[tag.end..];
        let space = rest.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        match rest[space..].split_first() {
            Some((b'_', data)) => {
                self.appended = Some((data, base64));
                Ok(())
            }
            _ => Err(ReadError::unexpected(Place::Byte(tag.end + space), "`_`", &rest[space..])),
        }
    }

    /// The position of an array's tag.
    pub(super) fn place(&self, array: &ArrayTag<'_>) -> Place {
        line_of(self.bytes, array.start)
    }

    /// `count` numbers of any type as double precision.
    pub(super) fn reals(&self, array: &ArrayTag<'a>, count: usize) -> Result<Vec<f64>, ReadError> {
        if let Format::Ascii { text } = array.format {
            return self.words(array, text, count);
        }
        Ok(match array.kind.as_ref() {
            "Float64" => self.binary(array, count, f64::from_le_bytes)?,
            "Float32" => self.binary(array, count, |bytes| f64::from(f32::from_le_bytes(bytes)))?,
            _ => self.integers(array, count)?.into_iter().map(|value| value as f64).collect(),
        })
    }

    /// `count` integers of any type; those too large for `i64` wrap to negative ones, which every caller rejects.
    pub(super) fn integers(&self, array: &ArrayTag<'a>, count: usize) -> Result<Vec<i64>, ReadError> {
        if let Format::Ascii { text } = array.format {
            return self.words(array, text, count);
        }
        match array.kind.as_ref() {
            "Int8" => self.binary(array, count, |bytes| i64::from(i8::from_le_bytes(bytes))),
            "UInt8" => self.binary(array, count, |bytes| i64::from(u8::from_le_bytes(bytes))),
            "Int16" => self.binary(array, count, |bytes| i64::from(i16::from_le_bytes(bytes))),
            "UInt16" => self.binary(array, count, |bytes| i64::from(u16::from_le_bytes(bytes))),
            "Int32" => self.binary(array, count, |bytes| i64::from(i32::from_le_bytes(bytes))),
            "UInt32" => self.binary(array, count, |bytes| i64::from(u32::from_le_bytes(bytes))),
            "Int64" => self.binary(array, count, i64::from_le_bytes),
            "UInt64" => self.binary(array, count, |bytes| u64::from_le_bytes(bytes) as i64),
            other => Err(ReadError::Unsupported {
                place: self.place(array),
                what: format!("array type {other}"),
                advice: "write coordinates as Float64 or Float32, indices as Int64 or Int32",
            }),
        }
    }

    fn words<T: std::str::FromStr>(
        &self,
        array: &ArrayTag<'_>,
        text: &[u8],
        count: usize,
    ) -> Result<Vec<T>, ReadError> {
        let room = text.len().div_ceil(2);
        if count > room {
            return Err(self.wrong_length(array, count, room));
        }
        // The cursor counts lines from the tag of the array.
        let first = || match self.place(array) {
            Place::Line(line) | Place::Byte(line) => line,
        };
        let from_head = |error| match error {
            ReadError::Unexpected { place: Place::Line(line), expected, found } => {
                ReadError::Unexpected { place: Place::Line(first() + line - 1), expected, found }
            }
            ReadError::Truncated { place: Place::Line(line), expected } => {
                ReadError::Truncated { place: Place::Line(first() + line - 1), expected }
            }
            other => other,
        };
        let mut cursor = Cursor::new(text);
        let values: Vec<T> =
            (0..count).map(|_| cursor.number("a number")).collect::<Result<_, _>>().map_err(from_head)?;
        cursor.skip_space();
        match cursor.rest() {
            [] => Ok(values),
            rest => Err(from_head(ReadError::unexpected(
                cursor.place(),
                format!("the end after {count} numbers"),
                rest,
            ))),
        }
    }

    fn binary<T, const N: usize>(
        &self,
        array: &ArrayTag<'a>,
        count: usize,
        from_le_bytes: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>, ReadError> {
        let bytes = self.decode(array, count.saturating_mul(N))?;
        let number = |chunk: &[u8; N]| {
            let mut chunk = *chunk;
            if !self.little_endian {
                chunk.reverse();
            }
            from_le_bytes(chunk)
        };
        Ok(bytes.as_chunks().0.iter().map(number).collect())
    }

    /// The bytes of an array that must have `expected` of them.
    fn decode(&self, array: &ArrayTag<'a>, expected: usize) -> Result<Vec<u8>, ReadError> {
        let mut source = match array.format {
            Format::Ascii { text } | Format::Binary { text } => Source::base64(text),
            Format::Appended { offset } => {
                let (data, base64) = self.appended.ok_or(ReadError::Missing { what: "AppendedData" })?;
                let data = data.get(offset..).ok_or_else(|| self.truncated(array))?;
                if base64 { Source::base64(data) } else { Source::Raw(data) }
            }
        };
        let before = source.left();
        let decoded = if self.compressed {
            self.inflate(array, &mut source, expected)
        } else {
            self.plain(array, &mut source, expected)
        }?;
        if let (Format::Appended { .. }, Some((data, _))) = (&array.format, self.appended) {
            self.taken.set(self.taken.get() + before - source.left());
            // Each byte may be read once: otherwise a short file could be decoded as often as it has tags.
            if self.taken.get() > data.len() {
                return Err(ReadError::Unsupported {
                    place: self.place(array),
                    what: "an array that shares appended data with another one".to_owned(),
                    advice: "write the data of each array at an offset of its own",
                });
            }
        }
        Ok(decoded)
    }

    fn plain(
        &self,
        array: &ArrayTag<'_>,
        source: &mut Source<'_>,
        expected: usize,
    ) -> Result<Vec<u8>, ReadError> {
        let length = self.header(array, source)?;
        if length != expected as u64 {
            return Err(self.wrong_length(array, expected, length));
        }
        source.take(expected).ok_or_else(|| self.truncated(array))
    }

    /// Blocks of equal size, of which the last may be shorter, each compressed separately.
    fn inflate(
        &self,
        array: &ArrayTag<'_>,
        source: &mut Source<'_>,
        expected: usize,
    ) -> Result<Vec<u8>, ReadError> {
        let blocks = self.header(array, source)?;
        let size = self.header(array, source)?;
        let last = self.header(array, source)?;
        let full = if last > 0 { blocks.saturating_sub(1) } else { blocks };
        let length = full.saturating_mul(size).saturating_add(if blocks > 0 { last } else { 0 });
        if length != expected as u64 {
            return Err(self.wrong_length(array, expected, length));
        }
        if blocks > (source.room() / self.header_bytes) as u64 {
            return Err(self.truncated(array));
        }
        let lengths: Vec<u64> = (0..blocks).map(|_| self.header(array, source)).collect::<Result<_, _>>()?;
        let mut out = Vec::with_capacity(expected.min(source.room().saturating_mul(MOST_PER_BYTE)));
        for (block, length) in (0..).zip(lengths) {
            let compressed = usize::try_from(length).ok().and_then(|length| source.take(length));
            let compressed = compressed.ok_or_else(|| self.truncated(array))?;
            let due = if block == full { last } else { size };
            let before = out.len();
            // One byte too many is enough to see that there is too much.
            let inflated =
                flate2::read::ZlibDecoder::new(&compressed[..]).take(due + 1).read_to_end(&mut out);
            if inflated.is_err() || (out.len() - before) as u64 != due {
                let found = format!("block {block}");
                let expected = format!("{due} bytes compressed with zlib");
                return Err(ReadError::unexpected(self.place(array), expected, found.as_bytes()));
            }
        }
        Ok(out)
    }

    fn header(&self, array: &ArrayTag<'_>, source: &mut Source<'_>) -> Result<u64, ReadError> {
        let word = source.take(self.header_bytes).ok_or_else(|| self.truncated(array))?;
        let digit = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
        Ok(if self.little_endian { word.iter().rev().fold(0, digit) } else { word.iter().fold(0, digit) })
    }

    fn wrong_length(
        &self,
        array: &ArrayTag<'_>,
        expected: usize,
        found: impl std::fmt::Display,
    ) -> ReadError {
        let found = format!("{found}");
        ReadError::unexpected(self.place(array), format!("an array of length {expected}"), found.as_bytes())
    }

    fn truncated(&self, array: &ArrayTag<'_>) -> ReadError {
        ReadError::Truncated { place: self.place(array), expected: "the data of this array".to_owned() }
    }
}

/// Bytes as they are, or in base64.
enum Source<'a> {
    Raw(&'a [u8]),
    /// Text not yet decoded, and decoded bytes not yet taken, last first.
    Base64 {
        text: &'a [u8],
        ready: Vec<u8>,
    },
}

impl<'a> Source<'a> {
    fn base64(text: &'a [u8]) -> Self {
        Self::Base64 { text, ready: Vec::new() }
    }

    /// Bytes of the file that are left.
    fn left(&self) -> usize {
        match self {
            Self::Raw(bytes) => bytes.len(),
            Self::Base64 { text, .. } => text.len(),
        }
    }

    /// An upper bound on the remaining bytes.
    fn room(&self) -> usize {
        match self {
            Self::Raw(bytes) => bytes.len(),
            Self::Base64 { text, ready } => text.len() / 4 * 3 + ready.len(),
        }
    }

    fn take(&mut self, length: usize) -> Option<Vec<u8>> {
        if length > self.room() {
            return None;
        }
        looked_at(length);
        match self {
            Self::Raw(bytes) => {
                let (taken, rest) = bytes.split_at(length);
                *bytes = rest;
                Some(taken.to_vec())
            }
            Self::Base64 { text, ready } => {
                let mut taken = Vec::with_capacity(length);
                while taken.len() < length {
                    match ready.pop() {
                        Some(byte) => taken.push(byte),
                        None => ready.extend(next_three(text)?.iter().rev().flatten()),
                    }
                }
                Some(taken)
            }
        }
    }
}

/// Decodes four characters into one to three bytes.
fn next_three(text: &mut &[u8]) -> Option<[Option<u8>; 3]> {
    let mut digits = [None; 4];
    for digit in &mut digits {
        let (&byte, rest) = text.trim_ascii_start().split_first()?;
        *text = rest;
        *digit = match byte {
            b'A'..=b'Z' => Some(byte - b'A'),
            b'a'..=b'z' => Some(byte - b'a' + 26),
            b'0'..=b'9' => Some(byte - b'0' + 52),
            b'+' => Some(62),
            b'/' => Some(63),
            b'=' => None,
            _ => return None,
        };
    }
    let [Some(a), Some(b), c, d] = digits else { return None };
    let third = |c: u8| c << 6 | d.unwrap_or(0);
    Some([Some(a << 2 | b >> 4), c.map(|c| b << 4 | c >> 2), c.and_then(|c| d.map(|_| third(c)))])
}
