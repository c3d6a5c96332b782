//! The text of STEP files, ISO 10303-21: instances `#12=KEYWORD(...);` by number.
//!
//! `Exchange::scan` finds where each instance stands, in one pass over the text; `Exchange::records` parses one when it
//! is needed. So memory goes with the number of instances, not with what they hold.

use std::{borrow::Cow, collections::HashMap, ops::Range};

use crate::{error::ImportError, limits::ImportLimits};

/// Lists in lists at most; STEP's geometry needs three.
const DEPTH: usize = 16;

/// A parameter of a record.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value<'a> {
    /// `#12`
    Reference(u64),
    /// `1.5E-3` or `3`
    Number(f64),
    /// `'text'`
    Text(Cow<'a, str>),
    /// `.METRE.`
    Enumeration(&'a str),
    /// `$` or `*`
    Absent,
    /// `(...)`, or the parameters of `KEYWORD(...)`
    List(Vec<Value<'a>>),
}

/// A keyword with its parameters. A complex instance has several.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Record<'a> {
    pub(crate) keyword: &'a str,
    pub(crate) parameters: Vec<Value<'a>>,
}

/// The instances of a file.
pub(crate) struct Exchange<'a> {
    text: &'a str,
    /// What stands between `=` and `;`, in the order of the file.
    instances: Vec<(u64, Range<usize>)>,
    by_number: HashMap<u64, usize>,
}

impl<'a> Exchange<'a> {
    /// Finds the instances of a file.
    pub(crate) fn scan(text: &'a str, limits: &ImportLimits) -> Result<Self, ImportError> {
        let mut exchange = Self { text, instances: Vec::new(), by_number: HashMap::new() };
        let mut cursor = Cursor { text, at: 0 };
        let mut data = false;
        loop {
            cursor.skip_blank()?;
            if cursor.at == text.len() {
                return Ok(exchange);
            }
            let start = cursor.at;
            let end = cursor.statement_end()?;
            let statement = text[start..end].trim_end();
            if statement == "ENDSEC" {
                data = false;
            } else if statement == "DATA" || statement.starts_with("DATA(") || statement.starts_with("DATA ")
            {
                data = true;
            } else if data {
                let mut inner = Cursor { text: &text[..end], at: start };
                let number = inner.instance_number()?;
                let count = exchange.instances.len() + 1;
                if count > limits.entities {
                    return Err(ImportError::Limit {
                        what: "entity instances",
                        found: count,
                        limit: limits.entities,
                    });
                }
                exchange.instances.push((number, inner.at..end));
                if exchange.by_number.insert(number, count - 1).is_some() {
                    return Err(exchange.syntax(start, format!("#{number} is defined twice")));
                }
            }
        }
    }

    /// Numbers of all instances of one of these types, in the order of the file. A complex instance may only mention it.
    pub(crate) fn of_type(&self, keywords: &[&str]) -> Vec<u64> {
        let is = |range: &Range<usize>| {
            let text = self.text[range.clone()].trim_start();
            if text.starts_with('(') {
                keywords.iter().any(|keyword| text.contains(keyword))
            } else {
                keywords.contains(&leading_keyword(text))
            }
        };
        self.instances.iter().filter(|(_, range)| is(range)).map(|(number, _)| *number).collect()
    }

    /// The first keyword of an instance, for messages; empty for a complex one.
    pub(crate) fn keyword(&self, number: u64) -> &'a str {
        self.range(number).map_or("", |range| leading_keyword(&self.text[range]))
    }

    /// The line at which an instance begins, from 1.
    pub(crate) fn line(&self, number: u64) -> usize {
        self.range(number).map_or(0, |range| line_of(self.text, range.start))
    }

    /// Parses an instance.
    pub(crate) fn records(&self, number: u64) -> Result<Vec<Record<'a>>, ImportError> {
        let Some(range) = self.range(number) else {
            return Err(ImportError::Missing { number });
        };
        let mut cursor = Cursor { text: &self.text[..range.end], at: range.start };
        cursor.skip_blank()?;
        let mut records = Vec::new();
        if cursor.peek() == Some(b'(') {
            cursor.at += 1;
            loop {
                cursor.skip_blank()?;
                if cursor.peek() == Some(b')') {
                    return Ok(records);
                }
                records.push(cursor.record()?);
            }
        }
        records.push(cursor.record()?);
        Ok(records)
    }

    /// An error about an instance.
    pub(crate) fn entity(&self, number: u64, message: String) -> ImportError {
        let entity = format!("#{number} {}", self.keyword(number)).trim_end().to_owned();
        ImportError::Entity { entity, line: self.line(number), message }
    }

    fn range(&self, number: u64) -> Option<Range<usize>> {
        self.by_number.get(&number).map(|&index| self.instances[index].1.clone())
    }

    fn syntax(&self, at: usize, message: String) -> ImportError {
        ImportError::Syntax { line: line_of(self.text, at), message }
    }
}

fn leading_keyword(text: &str) -> &str {
    let text = text.trim_start();
    let end = text.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(text.len());
    &text[..end]
}

fn line_of(text: &str, at: usize) -> usize {
    1 + text.as_bytes()[..at.min(text.len())].iter().filter(|&&b| b == b'\n').count()
}

/// A place in the text.
struct Cursor<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Cursor<'a> {
    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn error(&self, message: impl Into<String>) -> ImportError {
        ImportError::Syntax { line: line_of(self.text, self.at), message: message.into() }
    }

    /// What stands here, for messages.
    fn found(&self) -> String {
        let rest: String = self.text[self.at..].chars().take_while(|c| *c != '\n').take(20).collect();
        if rest.is_empty() { "the end".into() } else { format!("'{}'", rest.trim_end()) }
    }

    /// Skips white space and comments.
    fn skip_blank(&mut self) -> Result<(), ImportError> {
        loop {
            while self.peek().is_some_and(|b| b.is_ascii_whitespace()) {
                self.at += 1;
            }
            if !self.text.as_bytes()[self.at..].starts_with(b"/*") {
                return Ok(());
            }
            match self.text[self.at + 2..].find("*/") {
                Some(length) => self.at += length + 4,
                None => return Err(self.error("a comment is not closed")),
            }
        }
    }

    /// Skips to behind the next `;` outside texts and comments, and returns where it is.
    fn statement_end(&mut self) -> Result<usize, ImportError> {
        let bytes = self.text.as_bytes();
        let mut at = self.at;
        while at < bytes.len() {
            match bytes[at] {
                b';' => {
                    self.at = at + 1;
                    return Ok(at);
                }
                b'\'' => match self.text[at + 1..].find('\'') {
                    Some(length) => at += length + 2,
                    None => {
                        self.at = at;
                        return Err(self.error("a text is not closed"));
                    }
                },
                b'/' if bytes[at..].starts_with(b"/*") => match self.text[at + 2..].find("*/") {
                    Some(length) => at += length + 4,
                    None => {
                        self.at = at;
                        return Err(self.error("a comment is not closed"));
                    }
                },
                _ => at += 1,
            }
        }
        Err(self.error(format!("the file ends within a statement that begins with {}", self.found())))
    }

    /// `#12=`
    fn instance_number(&mut self) -> Result<u64, ImportError> {
        if self.peek() != Some(b'#') {
            return Err(self.error(format!("expected an instance such as #1=..., found {}", self.found())));
        }
        let number = self.reference()?;
        self.skip_blank()?;
        if self.peek() != Some(b'=') {
            return Err(self.error(format!("expected = after #{number}, found {}", self.found())));
        }
        self.at += 1;
        Ok(number)
    }

    fn reference(&mut self) -> Result<u64, ImportError> {
        let start = self.at + 1;
        let mut end = start;
        while self.text.as_bytes().get(end).is_some_and(u8::is_ascii_digit) {
            end += 1;
        }
        let number = self.text[start..end].parse();
        let number = number.map_err(|_| self.error(format!("{} is no instance number", self.found())))?;
        self.at = end;
        Ok(number)
    }

    fn record(&mut self) -> Result<Record<'a>, ImportError> {
        let keyword = leading_keyword(&self.text[self.at..]);
        self.at += keyword.len();
        self.skip_blank()?;
        if keyword.is_empty() || self.peek() != Some(b'(') {
            return Err(self.error(format!("expected KEYWORD(...), found {}", self.found())));
        }
        Ok(Record { keyword, parameters: self.list()? })
    }

    /// `(...)`, lists in lists on a stack of their own.
    fn list(&mut self) -> Result<Vec<Value<'a>>, ImportError> {
        let mut stack: Vec<Vec<Value<'a>>> = Vec::new();
        loop {
            self.skip_blank()?;
            let value = match self.peek() {
                Some(b'(') => {
                    if stack.len() == DEPTH {
                        return Err(self.error(format!("lists are nested more than {DEPTH} deep")));
                    }
                    self.at += 1;
                    stack.push(Vec::new());
                    continue;
                }
                Some(b')') => {
                    self.at += 1;
                    let Some(list) = stack.pop() else { return Err(self.error("a ) without its (")) };
                    if stack.is_empty() {
                        return Ok(list);
                    }
                    Value::List(list)
                }
                Some(b',') => {
                    self.at += 1;
                    continue;
                }
                // The keyword of a typed parameter says what its place says already.
                Some(b) if b.is_ascii_alphabetic() => {
                    self.at += leading_keyword(&self.text[self.at..]).len();
                    self.skip_blank()?;
                    if self.peek() != Some(b'(') {
                        return Err(self.error(format!("expected (, found {}", self.found())));
                    }
                    continue;
                }
                _ => self.simple()?,
            };
            match stack.last_mut() {
                Some(list) => list.push(value),
                None => return Err(self.error("expected (")),
            }
        }
    }

    fn simple(&mut self) -> Result<Value<'a>, ImportError> {
        let bytes = self.text.as_bytes();
        match self.peek() {
            Some(b'#') => Ok(Value::Reference(self.reference()?)),
            Some(b'$' | b'*') => {
                self.at += 1;
                Ok(Value::Absent)
            }
            Some(b'\'') => {
                let start = self.at + 1;
                let mut end = start;
                let mut doubled = false;
                loop {
                    match bytes.get(end) {
                        Some(b'\'') if bytes.get(end + 1) == Some(&b'\'') => {
                            doubled = true;
                            end += 2;
                        }
                        Some(b'\'') => break,
                        Some(_) => end += 1,
                        None => return Err(self.error("a text is not closed")),
                    }
                }
                self.at = end + 1;
                let text = &self.text[start..end];
                Ok(Value::Text(if doubled { text.replace("''", "'").into() } else { text.into() }))
            }
            Some(b'.') if bytes.get(self.at + 1).is_some_and(|b| !b.is_ascii_digit()) => {
                let rest = &self.text[self.at + 1..];
                let Some(length) = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_') else {
                    return Err(self.error("an enumeration is not closed"));
                };
                if rest.as_bytes()[length] != b'.' {
                    return Err(self.error(format!("expected an enumeration .NAME., found {}", self.found())));
                }
                self.at += length + 2;
                Ok(Value::Enumeration(&rest[..length]))
            }
            _ => {
                let rest = &self.text[self.at..];
                let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && !"+-.".contains(c));
                let word = &rest[..end.unwrap_or(rest.len())];
                match word.parse::<f64>() {
                    Ok(number) if number.is_finite() => {
                        self.at += word.len();
                        Ok(Value::Number(number))
                    }
                    _ => Err(self.error(format!("expected a parameter, found {}", self.found()))),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(data: &str) -> String {
        format!("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n")
    }

    #[test]
    fn every_kind_of_parameter() {
        let text = file(
            "/* a;'b */ #1 = POINT('it''s; /*',(1.,-.5E1 , 3),.T.,$,*,#2,LENGTH(2.5));\n#2=(A()\nB(1));",
        );
        let exchange = Exchange::scan(&text, &ImportLimits::default()).expect("a file");
        let [record] = &exchange.records(1).expect("an instance")[..] else { panic!("one record") };
        use Value::*;
        let numbers = List(vec![Number(1.0), Number(-5.0), Number(3.0)]);
        let expected = [
            Text("it's; /*".into()),
            numbers,
            Enumeration("T"),
            Absent,
            Absent,
            Reference(2),
            List(vec![Number(2.5)]),
        ];
        assert_eq!((record.keyword, &record.parameters[..]), ("POINT", &expected[..]));
        let complex = exchange.records(2).expect("an instance");
        assert_eq!(complex.iter().map(|r| r.keyword).collect::<Vec<_>>(), ["A", "B"]);
        assert_eq!((exchange.line(1), exchange.line(2)), (5, 6));
    }

    #[test]
    fn errors_have_their_line() {
        let fails = |data: &str| {
            let text = file(data);
            let exchange = Exchange::scan(&text, &ImportLimits::default());
            exchange.and_then(|e| e.records(1)).expect_err(data).to_string()
        };
        assert_eq!(fails("\n#1=A('x);"), "line 6: a text is not closed");
        assert_eq!(fails("#1=A(1);\n#1=B(2);"), "line 6: #1 is defined twice");
        assert_eq!(fails("#1=A(NaN);"), "line 5: expected (, found ')'");
        assert_eq!(fails("#1=A(1e999);"), "line 5: expected a parameter, found '1e999)'");
        assert_eq!(
            fails(&format!("#1=A{};", "(".repeat(100_000))),
            "line 5: lists are nested more than 16 deep"
        );
        assert_eq!(fails("#2=A(1);"), "#1 is referred to, and missing in the file: export it again");
    }
}
