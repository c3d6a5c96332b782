//! IGES files to surfaces: entity 128 (rational B-spline surface), names from 406 form 15, the unit of the global section.
//! Trimmed surfaces (143, 144) are accepted where nothing is trimmed off.

use std::collections::{HashMap, HashSet};

use moldline_geometry::PatchInput;
use moldline_spline::{KnotVector, MAX_DEGREE};

use crate::{
    error::ImportError,
    knots::with_clamped_ends,
    limits::ImportLimits,
    model::{FileUnit, Model},
    step::Budget,
};

/// Columns of an IGES line that are data; of parameter lines.
const DATA: usize = 72;
const PARAMETERS: usize = 64;

/// A directory entry.
struct Directory {
    kind: u32,
    form: u32,
    /// Line in the file, from 1.
    line: usize,
    /// Parameter lines: first, from 0, and count.
    first: usize,
    count: usize,
    /// Number of the transformation matrix's directory entry, or 0.
    matrix: usize,
    /// Whether another entity uses it as a part of itself.
    dependent: bool,
}

struct File<'a> {
    /// By number in the directory section: 1, 3, 5, ...
    directory: Vec<Directory>,
    /// The data columns of the lines of the parameter section, with their lines in the file.
    parameters: Vec<(&'a str, usize)>,
    delimiters: (char, char),
}

/// Reads the surfaces of an IGES file.
pub(crate) fn read(text: &str, limits: &ImportLimits) -> Result<Model, ImportError> {
    let mut global = String::new();
    let mut directory: Vec<(&str, usize)> = Vec::new();
    let mut parameters = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let Some((data, section)) = split_line(line) else {
            if line.trim().is_empty() {
                continue;
            }
            let message = "expected a line of 80 columns with the letter of its section in column 73";
            return Err(ImportError::Syntax { line: number, message: message.into() });
        };
        match section {
            'S' => {}
            'G' => global.push_str(data),
            'D' => directory.push((data, number)),
            'P' => parameters.push((data.get(..PARAMETERS).unwrap_or(data), number)),
            'T' => break,
            other => {
                let message = format!("{other} in column 73 is no section; there are S, G, D, P and T");
                return Err(ImportError::Syntax { line: number, message });
            }
        }
        if directory.len() / 2 > limits.entities {
            let found = directory.len() / 2;
            return Err(ImportError::Limit { what: "directory entries", found, limit: limits.entities });
        }
    }
    let (delimiters, unit) = global_section(&global)?;
    let directory = directory.chunks(2).map(entry).collect::<Result<Vec<_>, _>>()?;
    File { directory, parameters, delimiters }.model(unit, limits)
}

/// The data of a line, and the letter of its section.
fn split_line(line: &str) -> Option<(&str, char)> {
    let section = line.as_bytes().get(DATA)?;
    let data = line.get(..DATA)?;
    section.is_ascii_uppercase().then_some((data, char::from(*section)))
}

/// An entry of the directory: two lines of ten fields with eight columns each.
fn entry(lines: &[(&str, usize)]) -> Result<Directory, ImportError> {
    let (first, line) = lines[0];
    let field = |data: &str, line: usize, index: usize| -> Result<usize, ImportError> {
        let field = data.get(8 * index..8 * index + 8).unwrap_or("").trim();
        if field.is_empty() {
            return Ok(0);
        }
        // A negative matrix or structure is a pointer, too.
        field.trim_start_matches('-').parse().map_err(|_| ImportError::Syntax {
            line,
            message: format!("field {} of a directory entry is '{field}', no whole number", index + 1),
        })
    };
    let Some(&(second, second_line)) = lines.get(1) else {
        return Err(ImportError::Syntax {
            line,
            message: "a directory entry has one line instead of two".into(),
        });
    };
    let status = first.get(64..72).unwrap_or("");
    let start = field(first, line, 1)?;
    Ok(Directory {
        kind: field(first, line, 0)?.try_into().unwrap_or(0),
        form: field(second, second_line, 4)?.try_into().unwrap_or(0),
        line,
        first: start.saturating_sub(1),
        count: field(second, second_line, 3)?,
        matrix: field(first, line, 6)?,
        dependent: matches!(status.as_bytes().get(3), Some(b'1' | b'3')),
    })
}

/// Delimiters and unit of length.
fn global_section(text: &str) -> Result<((char, char), Option<FileUnit>), ImportError> {
    let first = |rest: &str, usual: char| match rest.strip_prefix("1H").and_then(|r| r.chars().next()) {
        Some(delimiter) => (delimiter, 3),
        None => (usual, 0),
    };
    let (parameter, used) = first(text, ',');
    let rest = text.get(used..).unwrap_or("");
    let rest = rest.strip_prefix(parameter).unwrap_or(rest);
    let (record, used) = first(rest, ';');
    let rest = rest.get(used..).unwrap_or("");
    let rest = rest.strip_prefix(parameter).unwrap_or(rest);
    let fields = Fields { text: rest, at: 0, delimiters: (parameter, record) };
    let fields: Vec<&str> =
        fields.collect::<Result<_, _>>().map_err(|message| ImportError::Syntax { line: 2, message })?;
    // Fields 14 and 15, of which the first two are the delimiters.
    let flag = fields.get(11).copied().unwrap_or("");
    let name = fields.get(12).map_or("", |name| text_of(name)).to_ascii_uppercase();
    let unit = |label: &str, metres| Some(FileUnit { label: label.into(), metres });
    let unit = match (flag, &name[..]) {
        ("1", _) | ("3", "IN" | "INCH") => unit("inch", 0.0254),
        ("2", _) | ("3", "MM") => unit("millimetre", 1e-3),
        ("4", _) | ("3", "FT") => unit("foot", 0.3048),
        ("6", _) | ("3", "M") => unit("metre", 1.0),
        ("7", _) | ("3", "KM") => unit("kilometre", 1e3),
        ("9", _) | ("3", "UM") => unit("micrometre", 1e-6),
        ("10", _) | ("3", "CM") => unit("centimetre", 1e-2),
        _ => None,
    };
    Ok(((parameter, record), unit))
}

/// The text of a Hollerith constant.
fn text_of(field: &str) -> &str {
    let is_count = |count: &str| !count.is_empty() && count.bytes().all(|b| b.is_ascii_digit());
    match field.split_once('H') {
        Some((count, text)) if is_count(count) => text,
        _ => field,
    }
}

/// Fields of free-format text, with Hollerith constants as a whole.
struct Fields<'t> {
    text: &'t str,
    at: usize,
    delimiters: (char, char),
}

impl<'t> Iterator for Fields<'t> {
    type Item = Result<&'t str, String>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.text.get(self.at..)?;
        if rest.is_empty() {
            return None;
        }
        let skipped = rest.len() - rest.trim_start().len();
        let digits = rest[skipped..].bytes().take_while(u8::is_ascii_digit).count();
        let mut from = 0;
        if digits > 0 && rest.as_bytes().get(skipped + digits) == Some(&b'H') {
            let count: usize = match rest[skipped..skipped + digits].parse() {
                Ok(count) => count,
                Err(_) => {
                    return Some(Err(format!("{} is no length of a text", &rest[skipped..skipped + digits])));
                }
            };
            from = (skipped + digits + 1).saturating_add(count);
            if rest.get(from..).is_none() {
                return Some(Err(format!("a text of {count} characters ends beyond its entity")));
            }
        }
        let (parameter, record) = self.delimiters;
        match rest[from..].find([parameter, record]) {
            Some(end) => {
                let is_last = rest[from + end..].starts_with(record);
                self.at = if is_last { self.text.len() } else { self.at + from + end + parameter.len_utf8() };
                Some(Ok(rest[..from + end].trim()))
            }
            None => {
                self.at = self.text.len();
                let field = rest.trim();
                (!field.is_empty()).then_some(Ok(field))
            }
        }
    }
}

/// Parameters of an entity, read one after the other.
struct Parameters {
    /// Without the type.
    fields: Vec<String>,
    entity: String,
    line: usize,
}

impl Parameters {
    fn error(&self, message: String) -> ImportError {
        ImportError::Entity { entity: self.entity.clone(), line: self.line, message }
    }

    fn field(&self, index: usize) -> Result<&str, ImportError> {
        let missing = || self.error(format!("has {} parameters, too few", self.fields.len()));
        self.fields.get(index).map(String::as_str).ok_or_else(missing)
    }

    /// A whole number; an empty field is 0.
    fn count(&self, index: usize, most: usize) -> Result<usize, ImportError> {
        let field = self.field(index)?;
        let number = if field.is_empty() { Ok(0) } else { field.parse::<usize>() };
        match number {
            Ok(number) if number <= most => Ok(number),
            _ => {
                Err(self.error(format!("parameter {} is '{field}', no whole number up to {most}", index + 1)))
            }
        }
    }

    fn number(&self, index: usize) -> Result<f64, ImportError> {
        let field = self.field(index)?;
        // Fortran's double precision has D.
        let number = if field.is_empty() { Ok(0.0) } else { field.replace(['D', 'd'], "E").parse::<f64>() };
        match number {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.error(format!("parameter {} is '{field}', no number", index + 1))),
        }
    }

    fn numbers(&self, first: usize, count: usize) -> Result<Vec<f64>, ImportError> {
        (first..first + count).map(|index| self.number(index)).collect()
    }
}

impl File<'_> {
    fn parameters(&self, number: usize) -> Result<Parameters, ImportError> {
        let Some(entry) = (number % 2 == 1).then(|| self.directory.get(number / 2)).flatten() else {
            return Err(ImportError::Missing { number: number as u64 });
        };
        let entity = format!("D{number} {}", entry.kind);
        let lines =
            entry.first.checked_add(entry.count).and_then(|end| self.parameters.get(entry.first..end));
        let Some(lines) = lines else {
            let message = "its parameters are beyond the end of the file".into();
            return Err(ImportError::Entity { entity, line: entry.line, message });
        };
        let text: String = lines.iter().map(|(data, _)| *data).collect();
        let line = lines.first().map_or(entry.line, |(_, line)| *line);
        let fields = Fields { text: &text, at: 0, delimiters: self.delimiters };
        let fields = fields.skip(1).map(|field| field.map(str::to_owned)).collect::<Result<_, _>>();
        let fields =
            fields.map_err(|message| ImportError::Entity { entity: entity.clone(), line, message })?;
        Ok(Parameters { fields, entity, line })
    }

    fn model(&self, unit: Option<FileUnit>, limits: &ImportLimits) -> Result<Model, ImportError> {
        let mut budget = Budget::new(limits);
        let mut names = HashMap::new();
        let mut surfaces = Vec::new();
        let mut trimmed = HashSet::new();
        let mut other: Vec<u32> = Vec::new();
        for (index, entry) in self.directory.iter().enumerate() {
            let number = 2 * index + 1;
            match entry.kind {
                128 => surfaces.push(number),
                406 if entry.form == 15 => {
                    let parameters = self.parameters(number)?;
                    names.insert(number, text_of(parameters.field(1)?).to_owned());
                }
                143 | 144 => {
                    trimmed.insert(self.whole_surface(number, entry.kind)?);
                }
                108 | 114 | 118 | 120 | 122 | 140 | 186 | 190..=198 | 510 if !other.contains(&entry.kind) => {
                    other.push(entry.kind);
                }
                _ => {}
            }
        }
        let mut patches = Vec::new();
        for number in surfaces {
            let entry = &self.directory[number / 2];
            if entry.dependent && !trimmed.contains(&number) {
                continue;
            }
            patches.push(self.surface(number, &names, &mut budget)?);
        }
        if patches.is_empty() && !other.is_empty() {
            let kinds: Vec<String> = other.iter().map(u32::to_string).collect();
            return Err(ImportError::NoSurfaces { hint: format!(": it has entities {}", kinds.join(", ")) });
        }
        Ok(Model { unit, sets: crate::group::by_label_or_contact(patches) })
    }

    /// The surface of a trimmed one (144) or bounded one (143) that has no boundary of its own.
    fn whole_surface(&self, number: usize, kind: u32) -> Result<usize, ImportError> {
        let parameters = self.parameters(number)?;
        let (surface, reason) = if kind == 144 {
            let outer = parameters.count(1, 1)?;
            let inner = parameters.count(2, usize::MAX)?;
            let reason = if inner > 0 { Some(format!("it has {inner} holes")) } else { None };
            let outer =
                (outer == 1).then(|| "it has an outer boundary of its own (entity 144, N1 = 1)".to_owned());
            (parameters.count(0, usize::MAX)?, reason.or(outer))
        } else {
            let boundaries = parameters.count(2, usize::MAX)?;
            let reason =
                (boundaries > 0).then(|| format!("it has {boundaries} boundaries of its own (entity 143)"));
            (parameters.count(1, usize::MAX)?, reason)
        };
        match reason {
            None => Ok(surface),
            Some(reason) => Err(ImportError::Trimmed {
                face: format!("D{number}"),
                set: "the file".into(),
                line: parameters.line,
                reason,
            }),
        }
    }

    fn surface(
        &self,
        number: usize,
        names: &HashMap<usize, String>,
        budget: &mut Budget<'_>,
    ) -> Result<PatchInput, ImportError> {
        let parameters = self.parameters(number)?;
        let most = parameters.fields.len();
        let (k_u, k_v) = (parameters.count(0, most)?, parameters.count(1, most)?);
        let (degree_u, degree_v) = (parameters.count(2, MAX_DEGREE)?, parameters.count(3, MAX_DEGREE)?);
        let (n_u, n_v) = (k_u + 1, k_v + 1);
        let count = n_u.saturating_mul(n_v);
        budget.take(count)?;
        let (knots_u, knots_v) = (n_u + degree_u + 1, n_v + degree_v + 1);
        let weights = 9 + knots_u + knots_v;
        let points = weights + count;
        let end = points + 3 * count + 4;
        if most < end {
            return Err(
                parameters.error(format!("has {most} parameters; {n_u} x {n_v} control points need {end}"))
            );
        }
        let valid = |direction, degree, first, count| {
            let knots = with_clamped_ends(degree, parameters.numbers(first, count)?);
            KnotVector::new(degree, knots).map_err(|source| ImportError::Knots {
                entity: parameters.entity.clone(),
                line: parameters.line,
                direction,
                source,
            })
        };
        let knots_u = valid('u', degree_u, 9, knots_u)?;
        let knots_v = valid('v', degree_v, 9 + n_u + degree_u + 1, knots_v)?;
        let weights = parameters.numbers(weights, count)?;
        if let Some(weight) = weights.iter().find(|w| !(1e-9..=1e9).contains(*w)) {
            return Err(
                parameters.error(format!("a weight is {weight}; weights must be positive, from 1e-9 to 1e9"))
            );
        }
        let flat = parameters.numbers(points, 3 * count)?;
        let matrix = self.matrix(self.directory[number / 2].matrix)?;
        // IGES has u fastest; patches have v fastest.
        let index = |i: usize, j: usize| j * n_u + i;
        let order = || (0..n_u).flat_map(move |i| (0..n_v).map(move |j| index(i, j)));
        let point = |at: usize| {
            let p = &flat[3 * at..3 * at + 3];
            [0, 1, 2].map(|row| {
                let [a, b, c, d] = matrix[row];
                a * p[0] + b * p[1] + c * p[2] + d
            })
        };
        let domain = parameters.numbers(points + 3 * count, 4)?;
        let (u, v) = (knots_u.domain(), knots_v.domain());
        // Some writers end the range one knot too far; short of the knots it cuts the surface.
        let covers = |range: &[f64], (a, b): (f64, f64)| {
            let hair = 1e-9 * (b - a);
            range[0] <= a + hair && b - hair <= range[1]
        };
        if !(covers(&domain[..2], u) && covers(&domain[2..], v)) {
            let [u0, u1, v0, v1] = [domain[0], domain[1], domain[2], domain[3]];
            let reason = format!("u from {u0} to {u1}, v from {v0} to {v1} is not all that its knots span");
            return Err(ImportError::Trimmed {
                face: parameters.entity.clone(),
                set: "the file".into(),
                line: parameters.line,
                reason,
            });
        }
        let equal = weights.iter().all(|w| *w == weights[0]);
        Ok(PatchInput {
            name: self.name(&parameters, end, names),
            knots_u,
            knots_v,
            control_points: order().map(point).collect(),
            weights: (!equal).then(|| order().map(|at| weights[at]).collect()),
        })
    }

    /// The name behind an entity's parameters: the number of associated entities, these, the number of properties, these.
    fn name(&self, parameters: &Parameters, end: usize, names: &HashMap<usize, String>) -> String {
        let count =
            |index: usize| parameters.fields.get(index).and_then(|f| f.parse::<usize>().ok()).unwrap_or(0);
        let properties = end.saturating_add(1).saturating_add(count(end));
        let properties = parameters.fields.get(properties..).unwrap_or(&[]);
        let name =
            properties.iter().filter_map(|f| f.parse().ok()).find_map(|number: usize| names.get(&number));
        name.cloned().unwrap_or_default()
    }

    /// The rows of a transformation matrix; the identity for 0.
    fn matrix(&self, number: usize) -> Result<[[f64; 4]; 3], ImportError> {
        if number == 0 {
            return Ok([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        }
        let parameters = self.parameters(number)?;
        let m = parameters.numbers(0, 12)?;
        Ok([0, 1, 2].map(|row| [m[4 * row], m[4 * row + 1], m[4 * row + 2], m[4 * row + 3]]))
    }
}
