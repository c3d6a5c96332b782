//! Records, and the hashes that verify them.

use std::time::{Duration, SystemTime};

use bytes::Bytes;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{error::StoreError, rows::KEPT};

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
    #[serde(with = "instant")]
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
    #[serde(with = "instant")]
    pub created: SystemTime,
    /// Time at which this generation was written.
    #[serde(with = "instant")]
    pub updated: SystemTime,
    /// Id of the request that wrote it; may be empty.
    pub request: String,
    /// Hash of the request that opened it; empty in records of older versions.
    #[serde(default)]
    pub opened: String,
    /// The last updates that had a request id, oldest first: as many as there are generations.
    #[serde(default)]
    pub updates: Vec<Update>,
    /// Whether the tenant had uploaded the set-up itself when it opened the session.
    #[serde(default)]
    pub own: bool,
    /// Bytes for which its entry in the index stands.
    #[serde(default)]
    pub charged: u64,
}

/// An update of a session that had a request id.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Update {
    /// Hash of the request id.
    pub id: String,
    /// Hash of the request's content.
    pub content: String,
    /// The generation that it wrote.
    pub generation: u64,
}

impl SessionRecord {
    /// Bytes of a session that do not count for its tenant.
    pub const FREE: u64 = 64 << 10;

    /// Notes the update that writes a generation, and forgets those whose generations are not kept.
    pub fn note(&mut self, update: Update) {
        let first = (update.generation + 1).saturating_sub(KEPT);
        self.updates.retain(|update| update.generation >= first);
        self.updates.push(update);
    }

    /// Bytes that count for the tenant: those of all generations that are kept, beyond [`FREE`](Self::FREE), in steps of
    /// powers of two. Never fewer than before.
    pub fn charge(&self) -> u64 {
        let numbers =
            self.design.0.len() + self.control_points.iter().map(|(_, of)| of.0.len()).sum::<usize>();
        let names: usize = self.control_points.iter().map(|(name, _)| name.len()).sum();
        // 16 digits for each number; labels, ids, hashes and times are within what is free.
        let row = KEPT * (16 * numbers as u64 + names as u64);
        let beyond = if row > Self::FREE { row.next_power_of_two() - Self::FREE } else { 0 };
        beyond.max(self.charged)
    }
}

/// Times, before 1970 too: whole seconds, rounded down, and nanoseconds.
mod instant {
    use std::time::{Duration, SystemTime};

    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    #[derive(Serialize, Deserialize)]
    struct Parts {
        secs_since_epoch: i64,
        nanos_since_epoch: u32,
    }

    pub fn serialize<S: Serializer>(time: &SystemTime, serializer: S) -> Result<S::Ok, S::Error> {
        let (secs, nanos) = match time.duration_since(SystemTime::UNIX_EPOCH) {
            Ok(after) => (i128::from(after.as_secs()), after.subsec_nanos()),
            Err(before) => {
                let before = before.duration();
                match before.subsec_nanos() {
                    0 => (-i128::from(before.as_secs()), 0),
                    nanos => (-i128::from(before.as_secs()) - 1, 1_000_000_000 - nanos),
                }
            }
        };
        let secs_since_epoch = i64::try_from(secs).map_err(serde::ser::Error::custom)?;
        Parts { secs_since_epoch, nanos_since_epoch: nanos }.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<SystemTime, D::Error> {
        let Parts { secs_since_epoch, nanos_since_epoch } = Parts::deserialize(deserializer)?;
        let seconds = Duration::from_secs(secs_since_epoch.unsigned_abs());
        let whole = match secs_since_epoch < 0 {
            true => SystemTime::UNIX_EPOCH.checked_sub(seconds),
            false => SystemTime::UNIX_EPOCH.checked_add(seconds),
        };
        let time = whole.and_then(|whole| whole.checked_add(Duration::from_nanos(nanos_since_epoch.into())));
        time.ok_or_else(|| D::Error::custom(format!("{secs_since_epoch} s is no time of this system")))
    }
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

pub(crate) fn check_hash(name: &str, hash: &str, content: &[u8]) -> Result<(), StoreError> {
    if blake3::hash(content).to_hex().as_str() == hash {
        return Ok(());
    }
    Err(StoreError::corrupt(name, format!("the hash of its {} bytes is not its name", content.len())))
}

/// Whether the last write was at least that long ago.
pub(crate) fn older(modified: SystemTime, grace: Duration) -> bool {
    modified.elapsed().unwrap_or_default() >= grace
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_kept_before_1970_and_as_older_versions_wrote_them() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct At(#[serde(with = "instant")] SystemTime);
        let at = |nanoseconds: i64| match nanoseconds < 0 {
            true => SystemTime::UNIX_EPOCH - Duration::from_nanos(nanoseconds.unsigned_abs()),
            false => SystemTime::UNIX_EPOCH + Duration::from_nanos(nanoseconds.unsigned_abs()),
        };
        for nanoseconds in [0, 1, -1, -1_000_000_000, -1_000_000_001, -157_766_400_500_000_000, 1 << 60] {
            let time = At(at(nanoseconds));
            let text = serde_json::to_string(&time).unwrap();
            assert_eq!(serde_json::from_str::<At>(&text).unwrap(), time, "{text}");
        }
        let now = SystemTime::now();
        assert_eq!(serde_json::to_string(&At(now)).unwrap(), serde_json::to_string(&now).unwrap());
        assert!(
            serde_json::from_str::<At>(
                r#"{"secs_since_epoch":9223372036854775807,"nanos_since_epoch":4294967295}"#
            )
            .is_err()
        );
    }

    #[test]
    fn a_session_is_charged_for_what_it_can_hold_in_steps() {
        let mut record = SessionRecord {
            setup: String::new(),
            design: Numbers(vec![0.0; 45]),
            control_points: Vec::new(),
            label: String::new(),
            created: SystemTime::UNIX_EPOCH,
            updated: SystemTime::UNIX_EPOCH,
            request: String::new(),
            opened: String::new(),
            updates: Vec::new(),
            own: true,
            charged: 0,
        };
        assert_eq!(record.charge(), 0);
        record.control_points = vec![("wing".to_owned(), Numbers(vec![0.0; 5600]))];
        record.charged = record.charge();
        let written = KEPT * seal(&record).unwrap().len() as u64;
        assert!((written - SessionRecord::FREE..2 * written).contains(&record.charged), "{}", record.charged);
        record.control_points.clear();
        assert!(record.charge() > 0, "what was reserved stays");
        for generation in 2..30 {
            record.note(Update { id: String::new(), content: String::new(), generation });
        }
        assert_eq!(record.updates.first().map(|update| update.generation), Some(30 - KEPT));
        assert_eq!(record.updates.len() as u64, KEPT);
    }

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
