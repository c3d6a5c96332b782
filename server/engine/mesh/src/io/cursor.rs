//! A cursor over bytes that reads words, lines and binary numbers.

use std::str::FromStr;

use super::{BYTE_ORDER_MARK, Place, ReadError, looked_at};

/// Coding of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coding {
    Ascii,
    LittleEndian,
    BigEndian,
}

pub(super) struct Cursor<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) position: usize,
    /// Coding of the numbers read by `int`, `size` and `real`.
    pub(super) coding: Coding,
}

impl<'a> Cursor<'a> {
    /// At the start, or behind a byte-order mark.
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let position = if bytes.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 };
        Self { bytes, position, coding: Coding::Ascii }
    }

    pub(super) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.position..]
    }

    /// The position of the next byte or word. Counts lines from the start: for errors only.
    pub(super) fn place(&self) -> Place {
        self.place_of(self.position)
    }

    /// The position of the byte or word at or after `position`. Counts lines from the start: for errors only.
    pub(super) fn place_of(&self, position: usize) -> Place {
        match self.coding {
            Coding::Ascii => {
                let rest = &self.bytes[position..];
                let space = rest.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
                line_of(self.bytes, position + space)
            }
            _ => Place::Byte(position),
        }
    }

    fn truncated(&self, expected: &str) -> ReadError {
        ReadError::Truncated { place: self.place(), expected: expected.to_owned() }
    }

    pub(super) fn skip_space(&mut self) {
        let space = self.rest().iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        self.position += space;
    }

    /// The next word, delimited by white space.
    pub(super) fn word(&mut self, expected: &str) -> Result<&'a [u8], ReadError> {
        self.skip_space();
        let length = self.rest().iter().take_while(|byte| !byte.is_ascii_whitespace()).count();
        if length == 0 {
            return Err(self.truncated(expected));
        }
        self.take(length, expected)
    }

    /// The rest of the line, without its end.
    pub(super) fn line(&mut self) -> &'a [u8] {
        let rest = self.rest();
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        looked_at(length);
        self.position += (length + 1).min(rest.len());
        rest[..length].trim_ascii()
    }

    /// A number written as a word.
    pub(super) fn number<T: FromStr>(&mut self, expected: &str) -> Result<T, ReadError> {
        let word = self.word(expected)?;
        let number = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
        number.ok_or_else(|| ReadError::unexpected(self.place_of(self.position - word.len()), expected, word))
    }

    pub(super) fn take(&mut self, length: usize, expected: &str) -> Result<&'a [u8], ReadError> {
        let taken = self.rest().get(..length).ok_or_else(|| self.truncated(expected))?;
        looked_at(length);
        self.position += length;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, expected: &str) -> Result<[u8; N], ReadError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, expected)?);
        Ok(array)
    }

    /// A signed integer of 32 bits.
    pub(super) fn int(&mut self, expected: &str) -> Result<i32, ReadError> {
        match self.coding {
            Coding::Ascii => self.number(expected),
            Coding::LittleEndian => self.array(expected).map(i32::from_le_bytes),
            Coding::BigEndian => self.array(expected).map(i32::from_be_bytes),
        }
    }

    /// An unsigned integer of 64 bits.
    pub(super) fn size(&mut self, expected: &str) -> Result<u64, ReadError> {
        match self.coding {
            Coding::Ascii => self.number(expected),
            Coding::LittleEndian => self.array(expected).map(u64::from_le_bytes),
            Coding::BigEndian => self.array(expected).map(u64::from_be_bytes),
        }
    }

    /// A number of double precision.
    pub(super) fn real(&mut self, expected: &str) -> Result<f64, ReadError> {
        match self.coding {
            Coding::Ascii => self.number(expected),
            Coding::LittleEndian => self.array(expected).map(f64::from_le_bytes),
            Coding::BigEndian => self.array(expected).map(f64::from_be_bytes),
        }
    }

    /// Checks that `count` things of at least `numbers` numbers fit into the rest of the file, and into `limit`.
    /// `bytes`: length of all those numbers in binary coding.
    pub(super) fn check_count(
        &self,
        what: &'static str,
        count: u64,
        numbers: usize,
        bytes: usize,
        limit: usize,
    ) -> Result<usize, ReadError> {
        let rest = self.rest().len();
        // In ASCII a number takes a digit and a space; the last may lack the space.
        let room = if self.coding == Coding::Ascii { (rest + 1) / (2 * numbers) } else { rest / bytes };
        let limit = room.min(limit);
        if count > limit as u64 {
            return Err(ReadError::TooMany { place: self.place(), what, count, limit: limit as u64 });
        }
        Ok(count as usize)
    }
}

pub(super) fn line_of(bytes: &[u8], position: usize) -> Place {
    looked_at(position);
    Place::Line(1 + bytes[..position].iter().filter(|&&byte| byte == b'\n').count())
}
