//! What an encoded message takes in memory when it is decoded, from its wire format and the descriptors, without decoding it.
//!
//! Bytes of byte fields count nothing: they stay where they are. Everything else counts with its size in Rust, twice in lists,
//! which grow by doubling.

use std::{collections::HashMap, sync::LazyLock};

use prost::{Message, encoding::decode_varint};
use prost_types::{
    DescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

/// Messages in messages, which the protocol has fewer of.
const DEEPEST: usize = 16;

/// A field of a message.
#[derive(Clone, Copy, Debug)]
enum Field {
    /// A message, by index; `inline` if its parent has a place for it already.
    Message { of: usize, inline: bool },
    /// A string or bytes in a place of this size; with its text if that is copied.
    Text { place: u64, copied: bool },
    /// A number, in a list if it is repeated; of this size, which it also has on the wire if it is `fixed`.
    Number { repeated: bool, size: u64, fixed: bool },
}

#[derive(Debug, Default)]
struct Kind {
    fields: HashMap<u32, Field>,
    /// Size of the struct, bytes, and for entries of a map that of the table around it.
    size: u64,
}

/// All messages of the protocol.
#[derive(Debug)]
struct Table {
    indices: HashMap<String, usize>,
    kinds: Vec<Kind>,
}

static TABLE: LazyLock<Table> = LazyLock::new(Table::of_protocol);

/// A message that is not well formed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Malformed {
    /// It ends within a field.
    Truncated,
    /// A field has no type of the wire format that the protocol uses.
    Wire(u64),
    /// Messages in messages beyond the protocol's.
    Deep,
}

impl std::fmt::Display for Malformed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Truncated => f.write_str("it ends within a field"),
            Self::Wire(wire) => write!(f, "a field has the wire type {wire}, which is not used"),
            Self::Deep => f.write_str("its parts are nested too deeply"),
        }
    }
}

/// The weight of the messages of a type.
#[derive(Clone, Copy, Debug)]
pub struct Weight(Option<usize>);

impl Weight {
    /// Of the messages of this name, without its package.
    pub fn of(name: &str) -> Self {
        Self(TABLE.indices.get(name).copied())
    }

    /// Bytes that `encoded` takes when it is decoded; counted no further than beyond `most`.
    ///
    /// # Errors
    /// If it is not well formed.
    pub fn bytes(self, encoded: &[u8], most: u64) -> Result<u64, Malformed> {
        match self.0 {
            Some(kind) => weigh(&TABLE, kind, encoded, most, DEEPEST),
            None => Ok(encoded.len() as u64),
        }
    }
}

fn weigh(table: &Table, kind: usize, mut rest: &[u8], most: u64, depth: usize) -> Result<u64, Malformed> {
    let depth = depth.checked_sub(1).ok_or(Malformed::Deep)?;
    let kind = &table.kinds[kind];
    let mut total = 0_u64;
    while !rest.is_empty() && total <= most {
        let key = varint(&mut rest)?;
        let field = u32::try_from(key >> 3).ok().and_then(|number| kind.fields.get(&number));
        let number = match field {
            Some(&Field::Number { repeated: true, size, .. }) => 2 * size,
            _ => 0,
        };
        match key & 7 {
            0 => {
                varint(&mut rest)?;
                total += number;
            }
            wire @ (1 | 5) => {
                rest = rest.get(if wire == 1 { 8 } else { 4 }..).ok_or(Malformed::Truncated)?;
                total += number;
            }
            2 => {
                let length = usize::try_from(varint(&mut rest)?).map_err(|_| Malformed::Truncated)?;
                let (content, after) = rest.split_at_checked(length).ok_or(Malformed::Truncated)?;
                rest = after;
                total += match field {
                    None => 0,
                    Some(&Field::Number { size, fixed: true, .. }) => number * (length as u64 / size),
                    Some(Field::Number { .. }) => number * varints(content),
                    Some(Field::Text { place, copied }) => {
                        2 * place + if *copied { length as u64 } else { 0 }
                    }
                    Some(Field::Message { of, inline }) => {
                        let place = if *inline { 0 } else { 2 * table.kinds[*of].size };
                        place + weigh(table, *of, content, most - total, depth)?
                    }
                };
            }
            wire => return Err(Malformed::Wire(wire)),
        }
    }
    Ok(total)
}

/// The numbers in a packed list: each has one last byte, whose highest bit is not set.
fn varints(content: &[u8]) -> u64 {
    content.iter().filter(|&&byte| byte < 0x80).count() as u64
}

fn varint(rest: &mut &[u8]) -> Result<u64, Malformed> {
    decode_varint(rest).map_err(|_| Malformed::Truncated)
}

impl Table {
    fn of_protocol() -> Self {
        let set = FileDescriptorSet::decode(crate::FILE_DESCRIPTOR_SET).unwrap_or_default();
        let mut messages: Vec<(String, DescriptorProto)> = Vec::new();
        for file in set.file.into_iter().filter(|file| file.package() == "moldline.v1") {
            let package = format!(".{}", file.package());
            messages.extend(file.message_type.into_iter().flat_map(|message| flatten(&package, message)));
        }
        let indices: HashMap<String, usize> =
            messages.iter().enumerate().map(|(index, (name, _))| (name.clone(), index)).collect();
        let mut kinds: Vec<Kind> = messages.iter().map(|(_, message)| kind(message, &indices)).collect();
        for index in 0..kinds.len() {
            kinds[index].size = size(&messages, &indices, index, DEEPEST);
        }
        let short = |name: &String| name.rsplit('.').next().unwrap_or_default().to_owned();
        Self { indices: indices.iter().map(|(name, &index)| (short(name), index)).collect(), kinds }
    }
}

/// A message and those declared within it, with their full names.
fn flatten(parent: &str, message: DescriptorProto) -> Vec<(String, DescriptorProto)> {
    let mut all = Vec::new();
    let mut stack = vec![(parent.to_owned(), message)];
    while let Some((parent, mut message)) = stack.pop() {
        let name = format!("{parent}.{}", message.name());
        stack.extend(message.nested_type.drain(..).map(|nested| (name.clone(), nested)));
        all.push((name, message));
    }
    all
}

fn kind(message: &DescriptorProto, indices: &HashMap<String, usize>) -> Kind {
    let fields = message.field.iter().map(|field| {
        let repeated = field.label() == Label::Repeated;
        let place = |size: u64| if repeated { size } else { 0 };
        let kind = match field.r#type() {
            Type::Message | Type::Group => match indices.get(field.type_name()) {
                Some(&of) => Field::Message { of, inline: !repeated },
                None => Field::Text { place: place(64), copied: true },
            },
            Type::String => Field::Text { place: place(24), copied: true },
            Type::Bytes => Field::Text { place: place(32), copied: false },
            Type::Uint32 | Type::Int32 | Type::Sint32 | Type::Bool | Type::Enum => {
                Field::Number { repeated, size: 4, fixed: false }
            }
            Type::Fixed32 | Type::Sfixed32 | Type::Float => Field::Number { repeated, size: 4, fixed: true },
            Type::Fixed64 | Type::Sfixed64 | Type::Double => Field::Number { repeated, size: 8, fixed: true },
            _ => Field::Number { repeated, size: 8, fixed: false },
        };
        (field.number() as u32, kind)
    });
    Kind { fields: fields.collect(), size: 0 }
}

/// Size of the struct of a message, bytes.
fn size(
    messages: &[(String, DescriptorProto)],
    indices: &HashMap<String, usize>,
    index: usize,
    depth: usize,
) -> u64 {
    let message = &messages[index].1;
    let parts = message.field.iter().map(|field| match field.r#type() {
        _ if field.label() == Label::Repeated => 24,
        Type::Message | Type::Group => match indices.get(field.type_name()) {
            Some(&of) if depth > 0 => 8 + size(messages, indices, of, depth - 1),
            _ => 64,
        },
        Type::String => 24,
        Type::Bytes => 32,
        _ => 8,
    });
    let entry = message.options.as_ref().is_some_and(|options| options.map_entry());
    parts.sum::<u64>() + if entry { 8 } else { 0 }
}

/// The number of a field.
#[cfg(test)]
pub fn number(message: &str, field: &str) -> Option<u32> {
    let set = FileDescriptorSet::decode(crate::FILE_DESCRIPTOR_SET).ok()?;
    let messages = set.file.into_iter().flat_map(|file| file.message_type);
    let fields = messages.into_iter().find(|known| known.name() == message)?.field;
    Some(fields.into_iter().find(|known| known.name() == field)?.number() as u32)
}
