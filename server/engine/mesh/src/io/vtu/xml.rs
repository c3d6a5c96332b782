//! The subset of XML that VTK writes: tags with attributes. Not strict, since VTK is not either: it writes `<` and `&` into
//! attributes unescaped, and raw bytes after `AppendedData`.

use std::{borrow::Cow, str::FromStr};

use crate::io::{ReadError, cursor::line_of, looked_at};

pub(super) struct Tag<'a> {
    pub(super) name: &'a str,
    attributes: Vec<(&'a str, &'a str)>,
    bytes: &'a [u8],
    /// Position of its `<`.
    pub(super) start: usize,
    /// Position after its `>`.
    pub(super) end: usize,
    /// `</name>`
    pub(super) closing: bool,
    /// `<name/>`
    pub(super) empty: bool,
}

impl<'a> Tag<'a> {
    pub(super) fn attribute(&self, name: &str) -> Option<Cow<'a, str>> {
        looked_at(self.attributes.len());
        let (_, value) = self.attributes.iter().find(|(other, _)| *other == name)?;
        Some(unescape(value))
    }

    /// An attribute that is a number.
    pub(super) fn number<T: FromStr>(&self, name: &str) -> Result<Option<T>, ReadError> {
        let Some(value) = self.attribute(name) else { return Ok(None) };
        let wrong = || {
            ReadError::unexpected(
                line_of(self.bytes, self.start),
                format!("a number in {name}"),
                value.as_bytes(),
            )
        };
        value.trim().parse().map(Some).map_err(|_| wrong())
    }

    /// A required attribute that is a number.
    pub(super) fn required<T: FromStr>(&self, name: &'static str) -> Result<T, ReadError> {
        self.number(name)?.ok_or_else(|| self.without(name))
    }

    /// The error of a missing or unknown attribute.
    pub(super) fn without(&self, expected: &str) -> ReadError {
        let found = &self.bytes[self.start..self.end];
        ReadError::unexpected(line_of(self.bytes, self.start), expected, found)
    }
}

pub(super) struct Scanner<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Scanner<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, position: 0 }
    }

    /// The text up to the next `<`.
    pub(super) fn text(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.position..];
        let length = rest.iter().position(|&byte| byte == b'<').unwrap_or(rest.len());
        looked_at(length);
        self.position += length;
        &rest[..length]
    }

    /// The next tag, past text, comments and declarations; none at the end of the file.
    pub(super) fn next_tag(&mut self) -> Result<Option<Tag<'a>>, ReadError> {
        loop {
            self.text();
            let start = self.position;
            let rest = &self.bytes[start..];
            if rest.is_empty() {
                return Ok(None);
            }
            if rest.starts_with(b"<!--") {
                self.skip_past(b"-->")?;
            } else if rest.starts_with(b"<?") || rest.starts_with(b"<!") {
                self.skip_past(b">")?;
            } else {
                return self.tag(start).map(Some);
            }
        }
    }

    fn skip_past(&mut self, end: &'static [u8]) -> Result<(), ReadError> {
        let rest = &self.bytes[self.position..];
        let found = rest.windows(end.len()).position(|window| window == end);
        looked_at(found.unwrap_or(rest.len()));
        self.position += found.ok_or_else(|| self.truncated("`>`"))? + end.len();
        Ok(())
    }

    fn tag(&mut self, start: usize) -> Result<Tag<'a>, ReadError> {
        self.position = start + 1;
        let closing = self.eat(b'/');
        let name = self.name()?;
        let mut tag =
            Tag { name, attributes: Vec::new(), bytes: self.bytes, start, end: start, closing, empty: false };
        loop {
            self.skip_space();
            tag.empty = self.eat(b'/');
            if self.eat(b'>') {
                tag.end = self.position;
                return Ok(tag);
            }
            let attribute = self.name()?;
            self.skip_space();
            if !self.eat(b'=') {
                return Err(self.unexpected("`=`"));
            }
            self.skip_space();
            let rest = &self.bytes[self.position..];
            let quote = *rest.first().ok_or_else(|| self.truncated("a quote"))?;
            if quote != b'"' && quote != b'\'' {
                return Err(self.unexpected("a quote"));
            }
            let length = rest[1..].iter().position(|&byte| byte == quote);
            let value = &rest[1..1 + length.ok_or_else(|| self.truncated("a closing quote"))?];
            let value = std::str::from_utf8(value).map_err(|_| self.unexpected("text in UTF-8"))?;
            looked_at(value.len() + 2);
            self.position += value.len() + 2;
            tag.attributes.push((attribute, value));
        }
    }

    fn name(&mut self) -> Result<&'a str, ReadError> {
        let rest = &self.bytes[self.position..];
        let part = |byte: &&u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b':' | b'.');
        let length = rest.iter().take_while(part).count();
        if length == 0 {
            return Err(if rest.is_empty() { self.truncated("a name") } else { self.unexpected("a name") });
        }
        self.position += length;
        // ASCII, as just seen.
        std::str::from_utf8(&rest[..length]).map_err(|_| self.unexpected("a name"))
    }

    fn eat(&mut self, byte: u8) -> bool {
        let found = self.bytes.get(self.position) == Some(&byte);
        self.position += usize::from(found);
        found
    }

    fn skip_space(&mut self) {
        self.position +=
            self.bytes[self.position..].iter().take_while(|byte| byte.is_ascii_whitespace()).count();
    }

    fn truncated(&self, expected: &str) -> ReadError {
        ReadError::Truncated { place: line_of(self.bytes, self.position), expected: expected.to_owned() }
    }

    fn unexpected(&self, expected: &str) -> ReadError {
        ReadError::unexpected(line_of(self.bytes, self.position), expected, &self.bytes[self.position..])
    }
}

const ENTITIES: [(&str, &str); 5] =
    [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")];

fn unescape(value: &str) -> Cow<'_, str> {
    if !value.contains('&') {
        return value.into();
    }
    // `&amp;` comes last, so that nothing is decoded twice.
    ENTITIES.iter().fold(value.to_owned(), |value, (entity, text)| value.replace(entity, text)).into()
}

pub(super) fn escape(text: &str) -> String {
    let escaped =
        ENTITIES.iter().rev().fold(text.to_owned(), |text, (entity, plain)| text.replace(plain, entity));
    // Control characters are not allowed in XML, whichever way they are written.
    escaped.replace(char::is_control, " ")
}
