//! What a file holds, whatever its format: named sets of patches, in the file's unit of length.

use moldline_geometry::PatchInput;
use serde::Serialize;

/// Surfaces of a file.
#[derive(Debug, Clone, Default)]
pub(crate) struct Model {
    /// The unit of length that the file names.
    pub(crate) unit: Option<FileUnit>,
    /// Sets of patches, in the order of the file.
    pub(crate) sets: Vec<SurfaceSet>,
}

/// A unit of length in a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FileUnit {
    /// What the file calls it.
    pub label: String,
    /// Metres per unit.
    pub metres: f64,
}

/// Patches that a file keeps together.
#[derive(Debug, Clone)]
pub(crate) struct SurfaceSet {
    /// Identifies the component; the sets of mirrored copies have the same one.
    pub(crate) id: String,
    /// Name for people.
    pub(crate) name: String,
    /// The patches, in the unit of the file.
    pub(crate) patches: Vec<PatchInput>,
}

/// ID and name in a label of OpenVSP, `ID, Name, SurfNo`, after `Surf_` on patches: the ID has ten capitals. Parts and delimiter are
/// options of its export, so that a label may be a name only.
pub(crate) fn split_label(label: &str) -> (Option<&str>, &str) {
    let label = label.trim();
    let label = label.strip_prefix("Surf_").unwrap_or(label);
    let is_id = |part: &str| part.len() == 10 && part.bytes().all(|b| b.is_ascii_uppercase());
    let Some(delimiter) = label.find(|c: char| !c.is_ascii_uppercase()) else {
        return if is_id(label) { (Some(label), label) } else { (None, label) };
    };
    let (id, rest) = label.split_at(delimiter);
    if !is_id(id) {
        return (None, without_numbers(label));
    }
    let separator =
        |c: char| c == ',' || c == ';' || c == '_' || c == '-' || c == '|' || c == ':' || c.is_whitespace();
    let name = without_numbers(rest.trim_start_matches(separator));
    (Some(id), if name.is_empty() { id } else { name })
}

/// The first number behind the name in a label, `SurfNo`, which tells mirrored copies apart; empty if there is none.
pub(crate) fn copy_number(label: &str) -> &str {
    let name = split_label(label).1;
    let Some(start) = label.find(name).filter(|_| !name.is_empty()) else { return "" };
    let rest = label[start + name.len()..].trim_start_matches(|c: char| !c.is_ascii_digit());
    &rest[..rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len())]
}

/// A label without the numbers and sides at its end: `Wing, 0, 12, lower` is `Wing`.
fn without_numbers(label: &str) -> &str {
    const SIDES: [&str; 6] = ["lower", "upper", "lelower", "leupper", "telower", "teupper"];
    let mut rest = label.trim();
    while let Some((before, last)) = rest.rsplit_once([',', ';', '|', ':']) {
        let last = last.trim();
        let numbered = !last.is_empty() && last.bytes().all(|b| b.is_ascii_digit());
        if !numbered && !SIDES.contains(&last) {
            break;
        }
        rest = before.trim_end();
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_openvsp() {
        for (label, id, name) in [
            ("TUAJTXHIWP, Fuse, 0", Some("TUAJTXHIWP"), "Fuse"),
            ("Surf_TUAJTXHIWP, Main wing, left, 1, 12, lower", Some("TUAJTXHIWP"), "Main wing, left"),
            ("TUAJTXHIWP_Fuse", Some("TUAJTXHIWP"), "Fuse"),
            ("TUAJTXHIWP", Some("TUAJTXHIWP"), "TUAJTXHIWP"),
            ("Fuse, 0", None, "Fuse"),
            ("WING", None, "WING"),
            ("", None, ""),
        ] {
            assert_eq!(split_label(label), (id, name), "{label}");
        }
        assert_eq!(copy_number("Surf_TUAJTXHIWP, Wing 2, 1, 12, lower"), "1");
        assert_eq!(copy_number("WING"), "");
    }
}
