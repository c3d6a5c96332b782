//! An instance with checked access to its parameters.

use crate::{
    error::ImportError,
    part21::{Exchange, Record, Value},
};

/// A parsed instance.
pub(super) struct Entity<'e, 'a> {
    exchange: &'e Exchange<'a>,
    pub(super) number: u64,
    records: Vec<Record<'a>>,
}

impl<'e, 'a> Entity<'e, 'a> {
    pub(super) fn parse(exchange: &'e Exchange<'a>, number: u64) -> Result<Self, ImportError> {
        Ok(Self { exchange, number, records: exchange.records(number)? })
    }

    /// The record with this keyword.
    pub(super) fn record(&self, keyword: &str) -> Result<&Record<'a>, ImportError> {
        let found = self.records.iter().find(|r| r.keyword == keyword);
        found.ok_or_else(|| self.error(format!("is no {keyword}")))
    }

    pub(super) fn is(&self, keyword: &str) -> bool {
        self.records.iter().any(|r| r.keyword == keyword)
    }

    pub(super) fn is_any(&self, keywords: &[&str]) -> bool {
        keywords.iter().any(|keyword| self.is(keyword))
    }

    /// Whether it is one record, with the attributes of all its supertypes.
    pub(super) fn is_simple(&self) -> bool {
        self.records.len() == 1
    }

    pub(super) fn error(&self, message: String) -> ImportError {
        self.exchange.entity(self.number, message)
    }

    pub(super) fn line(&self) -> usize {
        self.exchange.line(self.number)
    }

    /// `#12 KEYWORD`
    pub(super) fn label(&self) -> String {
        format!("#{} {}", self.number, self.records.first().map_or("", |r| r.keyword))
    }

    pub(super) fn value<'r>(
        &self,
        record: &'r Record<'a>,
        index: usize,
    ) -> Result<&'r Value<'a>, ImportError> {
        record.parameters.get(index).ok_or_else(|| {
            let count = record.parameters.len();
            self.error(format!("{} has {count} parameters, too few", record.keyword))
        })
    }

    /// A text; empty if absent.
    pub(super) fn text<'r>(&self, record: &'r Record<'a>, index: usize) -> Result<&'r str, ImportError> {
        match self.value(record, index)? {
            Value::Text(text) => Ok(text),
            Value::Absent => Ok(""),
            other => Err(self.wrong(record, index, "a text", other)),
        }
    }

    pub(super) fn list<'r>(
        &self,
        record: &'r Record<'a>,
        index: usize,
    ) -> Result<&'r [Value<'a>], ImportError> {
        match self.value(record, index)? {
            Value::List(list) => Ok(list),
            other => Err(self.wrong(record, index, "a list", other)),
        }
    }

    pub(super) fn reference(&self, record: &Record<'a>, index: usize) -> Result<u64, ImportError> {
        match self.value(record, index)? {
            Value::Reference(number) => Ok(*number),
            other => Err(self.wrong(record, index, "a reference", other)),
        }
    }

    /// A number, also as a measure.
    pub(super) fn number(&self, record: &Record<'a>, index: usize) -> Result<f64, ImportError> {
        match self.value(record, index)? {
            Value::Number(number) => Ok(*number),
            Value::List(list) if matches!(list[..], [Value::Number(_)]) => match list[0] {
                Value::Number(number) => Ok(number),
                _ => Ok(0.0),
            },
            other => Err(self.wrong(record, index, "a number", other)),
        }
    }

    /// A whole number from 0 to `most`.
    pub(super) fn count(&self, value: &Value<'_>, most: usize) -> Result<usize, ImportError> {
        match value {
            Value::Number(number) if number.fract() == 0.0 && (0.0..=most as f64).contains(number) => {
                Ok(*number as usize)
            }
            other => Err(self.error(format!("expected a whole number up to {most}, found {other:?}"))),
        }
    }

    pub(super) fn numbers(&self, record: &Record<'a>, index: usize) -> Result<Vec<f64>, ImportError> {
        let number = |value: &Value<'a>| match value {
            Value::Number(number) => Ok(*number),
            other => Err(self.wrong(record, index, "a list of numbers", other)),
        };
        self.list(record, index)?.iter().map(number).collect()
    }

    fn wrong(&self, record: &Record<'a>, index: usize, expected: &str, found: &Value<'_>) -> ImportError {
        let kind = match found {
            Value::Reference(_) => "a reference",
            Value::Number(_) => "a number",
            Value::Text(_) => "a text",
            Value::Enumeration(_) => "an enumeration",
            Value::Absent => "nothing",
            Value::List(_) => "a list",
        };
        self.error(format!("parameter {} of {} must be {expected}, and is {kind}", index + 1, record.keyword))
    }

    /// The instance that a parameter refers to.
    pub(super) fn follow(&self, record: &Record<'a>, index: usize) -> Result<Self, ImportError> {
        Self::parse(self.exchange, self.reference(record, index)?)
    }

    pub(super) fn at(&self, number: u64) -> Result<Self, ImportError> {
        Self::parse(self.exchange, number)
    }

    /// The coordinates of a CARTESIAN_POINT or DIRECTION.
    pub(super) fn coordinates(&self, keyword: &str) -> Result<[f64; 3], ImportError> {
        let record = self.record(keyword)?;
        match self.list(record, 1)? {
            [Value::Number(x), Value::Number(y), Value::Number(z)] => Ok([*x, *y, *z]),
            _ => Err(self.error("must have three coordinates".into())),
        }
    }
}
