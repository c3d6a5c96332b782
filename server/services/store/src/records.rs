//! Records, and the hashes that verify them.

use std::time::SystemTime;

use bytes::Bytes;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::error::StoreError;

/// The files of a set-up: the set-up file first, followed by the files to which it refers by path.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// The set-up file, then the others sorted by path.
    pub files: Vec<ManifestEntry>,
}

/// A file of a set-up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ManifestEntry {
    /// Relative path, with `/` between parts.
    pub path: String,
    /// BLAKE3 hash of its content, in hexadecimal digits.
    pub hash: String,
    /// Its size, bytes.
    pub size: u64,
}

impl Manifest {
    /// The manifest of paths and contents, the set-up file first.
    pub fn of<'f>(files: impl IntoIterator<Item = (&'f str, &'f [u8])>) -> Self {
        let entry = |(path, content): (&str, &[u8])| ManifestEntry {
            path: path.to_owned(),
            hash: blake3::hash(content).to_hex().to_string(),
            size: content.len() as u64,
        };
        let mut files: Vec<ManifestEntry> = files.into_iter().map(entry).collect();
        if let Some((_described, others)) = files.split_first_mut() {
            others.sort_by(|a, b| a.path.cmp(&b.path));
        }
        Self { files }
    }

    /// The id of the set-up, in hexadecimal digits. It does not depend on archives, nor on other uploaded files.
    pub fn id(&self) -> String {
        // Increases whenever the meaning of the format changes.
        let mut hasher = blake3::Hasher::new_derive_key("moldline set-up, format 1");
        for ManifestEntry { path, hash, .. } in &self.files {
            hasher.update(&(path.len() as u64).to_le_bytes());
            hasher.update(path.as_bytes());
            hasher.update(hash.as_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Total size of the files, bytes.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.size).sum()
    }
}

/// The tenants that may use a set-up besides its owner.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shared {
    /// Nobody.
    Private,
    /// These tenants.
    Tenants(Vec<String>),
    /// Every tenant.
    Public,
}

/// A tenant's upload of a set-up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AccessRecord {
    /// `false` once the tenant has deleted it.
    pub owned: bool,
    /// Who else may use it.
    pub shared: Shared,
    /// The user's title.
    pub name: String,
    /// Vertices of its mesh.
    pub vertices: u64,
    /// Cells of its mesh.
    pub cells: u64,
    /// Design variables.
    pub variables: u64,
    /// Size of its files.
    pub bytes: u64,
    /// Time of the tenant's first upload.
    pub created: SystemTime,
}

/// A session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionRecord {
    /// Id of its set-up.
    pub setup: String,
    /// Values of all variables.
    pub design: Numbers,
    /// Given control points: component and coordinates, m.
    pub control_points: Vec<(String, Numbers)>,
    /// The user's label.
    pub label: String,
    /// Time of its opening.
    pub created: SystemTime,
    /// Time at which this generation was written.
    pub updated: SystemTime,
    /// Id of the request that wrote it; may be empty.
    pub request: String,
}

/// Numbers that keep every bit: 16 hexadecimal digits each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Numbers(pub Vec<f64>);

impl From<Numbers> for String {
    fn from(Numbers(values): Numbers) -> Self {
        values.iter().map(|value| format!("{:016x}", value.to_bits())).collect()
    }
}

impl TryFrom<String> for Numbers {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let (groups, rest) = text.as_bytes().as_chunks::<16>();
        if !rest.is_empty() {
            return Err(format!("{} digits are no multiple of 16", text.len()));
        }
        let number = |digits: &[u8; 16]| {
            let digits = str::from_utf8(digits).map_err(|error| error.to_string())?;
            u64::from_str_radix(digits, 16).map(f64::from_bits).map_err(|error| error.to_string())
        };
        groups.iter().map(number).collect::<Result<_, _>>().map(Self)
    }
}

/// A record whose first line is the hash of the rest.
pub(crate) fn seal(record: &impl Serialize) -> Result<Bytes, StoreError> {
    let body = serde_json::to_vec(record).map_err(|error| StoreError::Unavailable {
        object: "a record".to_owned(),
        reason: error.to_string(),
    })?;
    let mut sealed = blake3::hash(&body).to_hex().to_string().into_bytes();
    sealed.push(b'\n');
    sealed.extend(body);
    Ok(sealed.into())
}

pub(crate) fn unseal<T: DeserializeOwned>(object: &str, sealed: &[u8]) -> Result<T, StoreError> {
    const DIGITS: usize = 2 * blake3::OUT_LEN;
    let corrupt = |reason: String| StoreError::corrupt(object, reason);
    if sealed.get(DIGITS) != Some(&b'\n') {
        return Err(corrupt(format!("{} bytes do not begin with a hash", sealed.len())));
    }
    let (hash, body) = (&sealed[..DIGITS], &sealed[DIGITS + 1..]);
    if blake3::hash(body).to_hex().as_bytes() != hash {
        return Err(corrupt("its hash is not that of its content".to_owned()));
    }
    serde_json::from_slice(body).map_err(|error| corrupt(error.to_string()))
}

/// Bytes followed by their hash.
pub(crate) fn seal_bytes(mut data: Vec<u8>) -> Bytes {
    let hash = blake3::hash(&data);
    data.extend_from_slice(hash.as_bytes());
    data.into()
}

pub(crate) fn unseal_bytes(object: &str, sealed: Bytes) -> Result<Bytes, StoreError> {
    let Some(length) = sealed.len().checked_sub(blake3::OUT_LEN) else {
        return Err(StoreError::corrupt(object, format!("{} bytes are too few", sealed.len())));
    };
    if blake3::hash(&sealed[..length]).as_bytes()[..] != sealed[length..] {
        return Err(StoreError::corrupt(object, "its hash is not that of its content"));
    }
    Ok(sealed.slice(..length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_every_bit() {
        let values = [0.1, -0.0, f64::MIN_POSITIVE / 8.0, 1e308, f64::INFINITY];
        let text = serde_json::to_string(&Numbers(values.to_vec())).unwrap();
        let back: Numbers = serde_json::from_str(&text).unwrap();
        assert_eq!(back.0.map_bits(), values.to_vec().map_bits());
        assert!(serde_json::from_str::<Numbers>("\"3ff\"").is_err());
        assert!(serde_json::from_str::<Numbers>("\"3ff000000000000g\"").is_err());
    }

    trait Bits {
        fn map_bits(&self) -> Vec<u64>;
    }

    impl Bits for Vec<f64> {
        fn map_bits(&self) -> Vec<u64> {
            self.iter().map(|value| value.to_bits()).collect()
        }
    }

    #[test]
    fn every_flipped_bit_of_a_record_is_noticed() {
        let sealed = seal(&Shared::Tenants(vec!["a".to_owned()])).unwrap();
        assert_eq!(unseal::<Shared>("x", &sealed).unwrap(), Shared::Tenants(vec!["a".to_owned()]));
        for bit in 0..8 * sealed.len() {
            let mut damaged = sealed.to_vec();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(matches!(unseal::<Shared>("x", &damaged), Err(StoreError::Corrupt { .. })), "bit {bit}");
        }
        for length in 0..sealed.len() {
            assert!(unseal::<Shared>("x", &sealed[..length]).is_err(), "length {length}");
        }
    }

    #[test]
    fn a_set_up_is_named_by_what_is_used_and_by_nothing_else() {
        let id = |files: &[(&str, &str)]| Manifest::of(files.iter().map(|(p, c)| (*p, c.as_bytes()))).id();
        let reference = id(&[("setup.toml", "s"), ("mesh.msh", "m"), ("wing.json", "w")]);
        assert_eq!(id(&[("setup.toml", "s"), ("wing.json", "w"), ("mesh.msh", "m")]), reference);
        assert_ne!(id(&[("setup.toml", "s"), ("mesh.msh", "m")]), reference);
        assert_ne!(id(&[("mesh.msh", "m"), ("setup.toml", "s"), ("wing.json", "w")]), reference);
        assert_ne!(id(&[("setup.toml", "s"), ("mesh.msh", "M"), ("wing.json", "w")]), reference);
        // Bytes cannot move from one file to the next.
        assert_ne!(id(&[("a", "xy"), ("b", "")]), id(&[("a", "x"), ("b", "y")]));
    }
}
