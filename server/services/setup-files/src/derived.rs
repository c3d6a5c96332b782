//! The engine's derived data of a set-up as bytes: numbers in order, little-endian, counts before rows.
//!
//! The reader checks every count; [`Setup::restore`](moldline_deform::Setup::restore) checks whether the numbers fit a set-up.

use moldline_deform::{
    Attachment, Derived, Factors, FoundLine, FoundSeams, Freedom, Location, OwnershipParts,
};
use moldline_spline::Vector3;

/// Build id of the engine: a hash of its sources, the compiler and the kind of processor. Derived data of another build are not
/// accepted.
pub const BUILD: &str = env!("MOLDLINE_BUILD");

/// The first bytes; they change with the order below.
const MAGIC: &[u8; 8] = b"MOLDDER2";

/// Writes derived data.
pub fn encode_derived(derived: &Derived) -> Vec<u8> {
    let Derived { ownership, seams, middles, fields } = derived;
    let numbers: usize = fields.iter().map(|factors| factors.top.len() + factors.lower.len() + 4).sum();
    let rows = ownership.attachments.len() + 2 * seams.points.len() + middles.len();
    let mut out = Writer(Vec::with_capacity(8 * numbers + 64 * rows + 1024));
    out.0.extend_from_slice(MAGIC);
    out.integers(&ownership.offsets);
    out.integers(&ownership.cell_owner);
    out.count(ownership.attachments.len());
    for Attachment { component, location, freedom, distance } in &ownership.attachments {
        let (kind, edge) = match freedom {
            Freedom::Surface => (0, 0),
            Freedom::Edge(edge) => (1, *edge),
            Freedom::Fixed => (2, 0),
        };
        [*component, location.patch, kind, edge].iter().for_each(|value| out.integer(*value));
        [location.u, location.v, *distance].iter().for_each(|value| out.number(*value));
    }
    out.count(seams.lines.len());
    for FoundLine { vertex, components, direction, bracket, limits, from_inside } in &seams.lines {
        let [reference, target] = *components;
        [*vertex, reference, target, u32::from(*from_inside)].iter().for_each(|value| out.integer(*value));
        [direction, bracket, limits].into_iter().flatten().for_each(|value| out.number(*value));
    }
    out.count(seams.points.len());
    seams.points.iter().flatten().for_each(|value| out.number(*value));
    out.number(seams.residual);
    out.count(middles.len());
    for Location { patch, u, v } in middles {
        out.integer(*patch);
        [*u, *v].iter().for_each(|value| out.number(*value));
    }
    out.count(fields.len());
    for Factors { shape_squared, regularisation, top, lower } in fields {
        out.number(*shape_squared);
        out.number(*regularisation);
        out.numbers(top);
        out.numbers(lower);
    }
    out.0
}

/// Reads data written by [`encode_derived`]; `None` if the bytes are something else.
pub fn decode_derived(bytes: &[u8]) -> Option<Derived> {
    let mut rest = Reader(bytes.strip_prefix(MAGIC)?);
    let offsets = rest.integers()?;
    let cell_owner = rest.integers()?;
    const ATTACHMENT: usize = 4 * 4 + 3 * 8;
    let attachments = (0..rest.count(ATTACHMENT)?).map(|_| {
        let (component, patch, kind, edge) =
            (rest.integer()?, rest.integer()?, rest.integer()?, rest.integer()?);
        let freedom = match kind {
            0 => Freedom::Surface,
            1 => Freedom::Edge(edge),
            2 => Freedom::Fixed,
            _ => return None,
        };
        let (u, v, distance) = (rest.number()?, rest.number()?, rest.number()?);
        Some(Attachment { component, location: Location { patch, u, v }, freedom, distance })
    });
    let attachments = attachments.collect::<Option<_>>()?;
    const LINE: usize = 4 * 4 + 6 * 8;
    let lines = (0..rest.count(LINE)?).map(|_| {
        let (vertex, components) = (rest.integer()?, [rest.integer()?, rest.integer()?]);
        let from_inside = match rest.integer()? {
            0 => false,
            1 => true,
            _ => return None,
        };
        let (direction, bracket, limits) = (rest.pair()?, rest.pair()?, rest.pair()?);
        Some(FoundLine { vertex, components, direction, bracket, limits, from_inside })
    });
    let lines = lines.collect::<Option<_>>()?;
    const POINT: usize = 3 * 8;
    let points = (0..rest.count(POINT)?)
        .map(|_| Some(Vector3::new(rest.number()?, rest.number()?, rest.number()?)))
        .collect::<Option<_>>()?;
    let seams = FoundSeams { lines, points, residual: rest.number()? };
    const MIDDLE: usize = 4 + 2 * 8;
    let middles = (0..rest.count(MIDDLE)?)
        .map(|_| Some(Location { patch: rest.integer()?, u: rest.number()?, v: rest.number()? }))
        .collect::<Option<_>>()?;
    const FIELD: usize = 4 * 8;
    let fields = (0..rest.count(FIELD)?).map(|_| {
        let (shape_squared, regularisation) = (rest.number()?, rest.number()?);
        Some(Factors { shape_squared, regularisation, top: rest.numbers()?, lower: rest.numbers()? })
    });
    let fields = fields.collect::<Option<_>>()?;
    let ownership = OwnershipParts { offsets, attachments, cell_owner };
    rest.0.is_empty().then_some(Derived { ownership, seams, middles, fields })
}

struct Writer(Vec<u8>);

impl Writer {
    fn integer(&mut self, value: u32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn number(&mut self, value: f64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn count(&mut self, count: usize) {
        self.0.extend_from_slice(&(count as u64).to_le_bytes());
    }

    fn integers(&mut self, values: &[u32]) {
        self.count(values.len());
        values.iter().for_each(|value| self.integer(*value));
    }

    fn numbers(&mut self, values: &[f64]) {
        self.count(values.len());
        values.iter().for_each(|value| self.number(*value));
    }
}

struct Reader<'b>(&'b [u8]);

impl<'b> Reader<'b> {
    fn take(&mut self, bytes: usize) -> Option<&'b [u8]> {
        let (taken, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        Some(taken)
    }

    fn integer(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    fn number(&mut self) -> Option<f64> {
        Some(f64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn pair(&mut self) -> Option<[f64; 2]> {
        Some([self.number()?, self.number()?])
    }

    /// A count of rows of at least so many bytes each, all of which are present.
    fn count(&mut self, row: usize) -> Option<usize> {
        let count = usize::try_from(u64::from_le_bytes(self.take(8)?.try_into().ok()?)).ok()?;
        (count.checked_mul(row)? <= self.0.len()).then_some(count)
    }

    fn integers(&mut self) -> Option<Vec<u32>> {
        let count = self.count(4)?;
        let bytes = self.take(4 * count)?;
        Some(bytes.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect())
    }

    fn numbers(&mut self) -> Option<Vec<f64>> {
        let count = self.count(8)?;
        let bytes = self.take(8 * count)?;
        Some(bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn derived() -> Derived {
        let location = Location { patch: 3, u: 0.25, v: -0.0 };
        let attachment = Attachment { component: 1, location, freedom: Freedom::Edge(7), distance: 1e-9 };
        let fixed = Attachment { freedom: Freedom::Fixed, ..attachment };
        Derived {
            ownership: OwnershipParts {
                offsets: vec![0, 1, 2],
                attachments: vec![attachment, fixed],
                cell_owner: vec![1, 1, 0],
            },
            seams: FoundSeams {
                lines: vec![FoundLine {
                    vertex: 9,
                    components: [1, 0],
                    direction: [0.0, -2.0],
                    bracket: [-0.25, 0.5],
                    limits: [-1.0, 1.5],
                    from_inside: true,
                }],
                points: vec![Vector3::new(1.0, 2.0, 3.0), Vector3::zeros()],
                residual: 1e-12,
            },
            middles: vec![location],
            fields: vec![
                Factors {
                    shape_squared: 0.5,
                    regularisation: 0.25,
                    top: vec![1.0, 2.0],
                    lower: vec![3.0, -4.0, 5.0],
                },
                Factors::default(),
            ],
        }
    }

    #[test]
    fn what_is_written_is_read() {
        assert_eq!(decode_derived(&encode_derived(&derived())), Some(derived()));
        assert_eq!(decode_derived(&encode_derived(&Derived::default())), Some(Derived::default()));
    }

    #[test]
    fn what_is_cut_or_has_wrong_counts_is_not_read() {
        let whole = encode_derived(&derived());
        for length in 0..whole.len() {
            assert_eq!(decode_derived(&whole[..length]), None, "{length} bytes");
        }
        let mut longer = whole.clone();
        longer.push(0);
        assert_eq!(decode_derived(&longer), None);
        let mut huge = whole;
        huge[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert_eq!(decode_derived(&huge), None);
    }
}
