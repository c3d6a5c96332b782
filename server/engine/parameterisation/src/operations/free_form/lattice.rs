//! The control lattice, organised by spanwise sections.
//!
//! Section k stands at a station of the span (the Greville abscissae, so that the coordinate xi_2 is linear along the
//! span) with the quarter chord Q_k, the chord c_k and the directions e_k (leading to trailing edge) and n_k (across,
//! up) of the reference geometry cut there. The lattice point (i, k, j) lies at
//!
//!   B = Q_k + shift_k + Rot(twist_k) [ a_i c_k (1 + chi_k) e_k + b n_k ],
//!   b = c_k ( t_j (1 + chi'_k) + (1 + chi_k) (camber_ik + sigma_j thickness_ik) ),
//!
//! where a_i counts from the quarter chord and t_j from the chord line, in chords, sigma_j runs from -1 (lowest layer)
//! to 1 (uppermost), and the lattice is just wide enough for all control points. Because a_i and t_j are linear in
//! the Greville abscissae too, the reference volume is affine in (xi_1, xi_3) at fixed xi_2, and its inverse needs no
//! iteration.

use moldline_foundation::Vector3;
use moldline_spline::{KnotVector, Volume};
use nalgebra::convert;

use super::declaration::FreeFormDeclaration;
use crate::axis::Axes;
use crate::compile::Site;
use crate::error::ParameterisationError;
use crate::scalar::Scalar;
use crate::sections::{SampledSurfaces, Section};

/// Sections shorter than this fraction of the largest chord get this chord, so that their frames stay well defined (a
/// pointed tip).
const SMALLEST_CHORD: f64 = 0.05;
/// Width of the lattice, in chords, where the embedded points have none (a flat plate).
const SMALLEST_WIDTH: f64 = 0.02;

/// Slots of a section's quantities: chi, chi', shift x y z, twist, then camber and thickness of each row.
pub(super) const STRETCH: usize = 0;
pub(super) const THICKNESS_STRETCH: usize = 1;
pub(super) const SHIFT: usize = 2;
pub(super) const TWIST: usize = 5;
pub(super) const CAMBER: usize = 6;

/// The trivariate basis of a block.
pub(super) fn volume(
    site: &Site,
    declaration: &FreeFormDeclaration,
) -> Result<Volume, ParameterisationError> {
    let knots = |d: usize| {
        KnotVector::clamped_uniform(declaration.degree[d], declaration.shape[d]).map_err(|source| {
            ParameterisationError::Knots { field: site.field(&format!("shape[{d}]")), source }
        })
    };
    Ok(Volume::new([knots(0)?, knots(1)?, knots(2)?]))
}

/// A closed interval.
#[derive(Clone, Copy, Debug)]
struct Extent {
    low: f64,
    high: f64,
}

impl Extent {
    /// The smallest interval that contains all values.
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let none = Self { low: f64::INFINITY, high: f64::NEG_INFINITY };
        values.fold(none, |all, v| Self { low: all.low.min(v), high: all.high.max(v) })
    }

    /// Widened about its middle to `width` at least.
    fn at_least(self, width: f64) -> Self {
        let missing = (0.5 * (width - (self.high - self.low))).max(0.0);
        Self { low: self.low - missing, high: self.high + missing }
    }

    fn at(self, fraction: f64) -> f64 {
        self.low + (self.high - self.low) * fraction
    }

    fn fraction(self, x: f64) -> f64 {
        (x - self.low) / (self.high - self.low)
    }
}

/// Quarter chord, e and c of a section; vectors have two components: chord axis, thickness axis.
#[derive(Clone, Copy, Debug)]
struct Frame {
    quarter_chord: [f64; 2],
    direction: [f64; 2],
    chord: f64,
}

impl Frame {
    fn new(section: &Section, smallest: f64) -> Self {
        let [cx, cz] = section.chord;
        let chord = cx.hypot(cz);
        let direction = if chord > smallest { [cx / chord, cz / chord] } else { [1.0, 0.0] };
        Self { quarter_chord: section.quarter_chord(), direction, chord: chord.max(smallest) }
    }
}

/// The sections of the reference geometry.
#[derive(Clone, Debug)]
pub(super) struct Sections {
    pub(super) axes: Axes,
    symmetric: bool,
    /// Along the span axis, m.
    span: Extent,
    /// Coordinates of the sections along the span axis, m.
    pub(super) stations: Vec<f64>,
    frames: Vec<Frame>,
}

/// Coordinates of a point in the reference block: a and t in the section frame interpolated at xi_2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    along: f64,
    xi_span: f64,
    across: f64,
}

impl Sections {
    /// Cuts the surfaces at the Greville abscissae of `knots` over the span of the `embedded` points.
    pub(super) fn cut(
        site: &Site,
        declaration: &FreeFormDeclaration,
        knots: &KnotVector,
        surfaces: &SampledSurfaces,
        embedded: &[Vector3],
    ) -> Result<Self, ParameterisationError> {
        let axes = Axes::of_span(declaration.span);
        let symmetric = declaration.symmetric;
        let mut span = Extent::of(embedded.iter().map(|point| point[axes.span]));
        if symmetric {
            let reach = span.low.abs().max(span.high.abs());
            span = Extent { low: -reach, high: reach };
        }
        if span.low >= span.high {
            return Err(site.geometry("the embedded components have no extent along the span axis"));
        }
        let mut stations: Vec<f64> = knots.greville().iter().map(|&g| span.at(g)).collect();
        if symmetric {
            // Exactly, so that a symmetric component stays symmetric to the last bit.
            let count = stations.len();
            for k in 0..count / 2 {
                stations[k] = -stations[count - 1 - k];
            }
            if count % 2 == 1 {
                stations[count / 2] = 0.0;
            }
        }
        let sections = stations
            .iter()
            .map(|&station| surfaces.section(axes, station, symmetric))
            .collect::<Option<Vec<Section>>>()
            .ok_or_else(|| site.geometry("a section has no chord: is the span axis right?"))?;
        let largest = sections.iter().map(|s| s.chord[0].hypot(s.chord[1])).fold(0.0, f64::max);
        let frames = sections.iter().map(|s| Frame::new(s, SMALLEST_CHORD * largest)).collect();
        Ok(Self { axes, symmetric, span, stations, frames })
    }

    /// The argument of a section-level function, from root (0) to tip (1).
    pub(super) fn eta(&self, station: f64) -> f64 {
        if self.symmetric {
            let reach = self.stations.iter().fold(0.0, |m: f64, y| m.max(y.abs()));
            station.abs() / reach
        } else {
            let start = self.stations.first().copied().unwrap_or_default();
            let end = self.stations.last().copied().unwrap_or_default();
            (station - start) / (end - start)
        }
    }

    /// Whether a point is on the port side of a mirrored block, where it takes the coordinates of its image, so that
    /// both sides get the same bits.
    pub(super) fn is_image(&self, point: &Vector3) -> bool {
        self.symmetric && point[self.axes.span] < 0.0
    }

    /// Whether a point is on the plane of symmetry.
    pub(super) fn is_on_plane(&self, point: &Vector3) -> bool {
        self.symmetric && point[self.axes.span] == 0.0
    }

    /// The coordinates of a point, which may be outside the block.
    pub(super) fn locate(&self, point: &Vector3, knots: &KnotVector) -> Place {
        let station = if self.is_image(point) { -point[self.axes.span] } else { point[self.axes.span] };
        let xi_span = self.span.fraction(station).clamp(0.0, 1.0);
        let basis = knots.basis(xi_span, 0);
        let (mut origin, mut chord) = ([0.0; 2], [0.0; 2]);
        for (frame, weight) in self.frames[basis.first..].iter().zip(basis.value()) {
            for a in 0..2 {
                origin[a] += weight * frame.quarter_chord[a];
                chord[a] += weight * frame.chord * frame.direction[a];
            }
        }
        let d = [point[self.axes.chord] - origin[0], point[self.axes.thickness] - origin[1]];
        let square = chord[0] * chord[0] + chord[1] * chord[1];
        let along = (d[0] * chord[0] + d[1] * chord[1]) / square;
        let across = (d[1] * chord[0] - d[0] * chord[1]) / square;
        Place { along, xi_span, across }
    }

    /// The vector with components along e and n of a frame.
    fn in_space<T: Scalar>(&self, frame: &Frame, [a, b]: [T; 2]) -> nalgebra::Vector3<T> {
        let [ex, ez] = frame.direction.map(convert::<f64, T>);
        let mut v = nalgebra::Vector3::zeros();
        v[self.axes.chord] = a * ex - b * ez;
        v[self.axes.thickness] = a * ez + b * ex;
        v
    }

    /// Components along e and n of a vector.
    fn in_frame(&self, frame: &Frame, v: &Vector3) -> [f64; 2] {
        let [ex, ez] = frame.direction;
        let (x, z) = (v[self.axes.chord], v[self.axes.thickness]);
        [x * ex + z * ez, z * ex - x * ez]
    }
}

/// One section's quantities with the sine and cosine of its twist.
struct Turned<'a, T> {
    values: &'a [T],
    sin: T,
    cos: T,
    rows: usize,
}

impl<'a, T: Scalar> Turned<'a, T> {
    fn new(values: &'a [T], rows: usize) -> Self {
        let (sin, cos) = values[TWIST].sin_cos();
        Self { values, sin, cos, rows }
    }

    /// kappa + sigma tau of a row.
    fn bulge(&self, row: usize, layer: f64) -> T {
        self.values[CAMBER + row] + convert::<f64, T>(layer) * self.values[CAMBER + self.rows + row]
    }

    /// Coordinates along e and n before the twist, in chords.
    fn flat(&self, row: usize, along: f64, across: f64, layer: f64) -> [T; 2] {
        let [along, across] = [along, across].map(convert::<f64, T>);
        let stretch = T::one() + self.values[STRETCH];
        let thickness = T::one() + self.values[THICKNESS_STRETCH];
        [along * stretch, across * thickness + stretch * self.bulge(row, layer)]
    }

    /// Coordinates along e and n after the twist: positive twist takes the trailing edge down.
    fn turn(&self, [a, b]: [T; 2]) -> [T; 2] {
        [self.cos * a + self.sin * b, self.cos * b - self.sin * a]
    }
}

/// The control lattice over the sections. Its displacement is the free-form block's only non-linear step.
#[derive(Clone, Debug)]
pub(super) struct SectionLattice {
    pub(super) volume: Volume,
    pub(super) sections: Sections,
    /// The extents of a and of t over all embedded points.
    along_extent: Extent,
    across_extent: Extent,
    /// a_i, t_j and sigma_j.
    along: Vec<f64>,
    across: Vec<f64>,
    layer: Vec<f64>,
}

impl SectionLattice {
    /// The lattice just wide enough for the places of the embedded points.
    pub(super) fn new(volume: Volume, sections: Sections, embedded: &[Place]) -> Self {
        let along_extent = Extent::of(embedded.iter().map(|p| p.along)).at_least(SMALLEST_WIDTH);
        let across_extent = Extent::of(embedded.iter().map(|p| p.across)).at_least(SMALLEST_WIDTH);
        let greville = |d: usize| volume.knots()[d].greville();
        let along = greville(0).iter().map(|&g| along_extent.at(g)).collect();
        let across = greville(2).iter().map(|&g| across_extent.at(g)).collect();
        let layer = greville(2).iter().map(|g| 2.0 * g - 1.0).collect();
        Self { volume, sections, along_extent, across_extent, along, across, layer }
    }

    /// Slots per section.
    pub(super) fn slots(&self) -> usize {
        CAMBER + 2 * self.along.len()
    }

    /// Numbers of lattice points along chord, span and thickness.
    pub(super) fn shape(&self) -> [usize; 3] {
        self.volume.shape()
    }

    /// Number of lattice points.
    pub(super) fn len(&self) -> usize {
        self.along.len() * self.sections.frames.len() * self.across.len()
    }

    /// Parameters of the volume at a place.
    pub(super) fn xi(&self, place: &Place) -> [f64; 3] {
        [self.along_extent.fraction(place.along), place.xi_span, self.across_extent.fraction(place.across)]
    }

    /// Index of a lattice point's image across the plane of symmetry.
    pub(super) fn mirror(&self, index: usize) -> usize {
        let (n_span, n_across) = (self.sections.frames.len(), self.across.len());
        let (row, layer) = (index / n_across, index % n_across);
        let (i, k) = (row / n_span, row % n_span);
        (i * n_span + n_span - 1 - k) * n_across + layer
    }

    /// Lattice points of the reference block, m, index `(i n_span + k) n_across + j`.
    pub(super) fn reference(&self) -> Vec<Vector3> {
        let Sections { axes, stations, frames, .. } = &self.sections;
        self.each_point(|i, k, j| {
            let frame = &frames[k];
            let local = [self.along[i] * frame.chord, self.across[j] * frame.chord];
            let mut point = self.sections.in_space(frame, local);
            point[axes.span] += stations[k];
            point[axes.chord] += frame.quarter_chord[0];
            point[axes.thickness] += frame.quarter_chord[1];
            point
        })
    }

    /// B* - B0, exactly zero at the baseline.
    pub(super) fn displacement<T: Scalar>(&self, quantities: &[T]) -> Vec<nalgebra::Vector3<T>> {
        let sections = self.turned(quantities);
        self.each_point(|i, k, j| {
            let (section, frame) = (&sections[k], &self.sections.frames[k]);
            let [a, b] = section.turn(section.flat(i, self.along[i], self.across[j], self.layer[j]));
            let from_rest = [a - convert(self.along[i]), b - convert(self.across[j])];
            let step = from_rest.map(|d| d * convert(frame.chord));
            nalgebra::Vector3::from_column_slice(&section.values[SHIFT..TWIST])
                + self.sections.in_space(frame, step)
        })
    }

    /// The change of the displacement with the `change` of the quantities.
    pub(super) fn jvp(&self, quantities: &[f64], change: &[f64]) -> Vec<Vector3> {
        let sections = self.turned(quantities);
        self.each_point(|i, k, j| {
            let (section, frame) = (&sections[k], &self.sections.frames[k]);
            let d = &change[k * self.slots()..(k + 1) * self.slots()];
            let (along, across, layer) = (self.along[i], self.across[j], self.layer[j]);
            let [a, b] = section.turn(section.flat(i, along, across, layer));
            let bulge = d[CAMBER + i] + layer * d[CAMBER + self.along.len() + i];
            let da = along * d[STRETCH];
            let db = across * d[THICKNESS_STRETCH]
                + (1.0 + section.values[STRETCH]) * bulge
                + section.bulge(i, layer) * d[STRETCH];
            let [ta, tb] = section.turn([da, db]);
            let step = [ta + b * d[TWIST], tb - a * d[TWIST]].map(|v| v * frame.chord);
            Vector3::from_column_slice(&d[SHIFT..TWIST]) + self.sections.in_space(frame, step)
        })
    }

    /// Seeds on the quantities for `seeds` on the lattice points.
    pub(super) fn vjp(&self, quantities: &[f64], seeds: &[Vector3]) -> Vec<f64> {
        let sections = self.turned(quantities);
        let mut on = vec![0.0; quantities.len()];
        self.each(|index, i, k, j| {
            let (section, frame) = (&sections[k], &self.sections.frames[k]);
            let on = &mut on[k * self.slots()..(k + 1) * self.slots()];
            let (along, across, layer) = (self.along[i], self.across[j], self.layer[j]);
            let [a, b] = section.turn(section.flat(i, along, across, layer));
            let [sa, sb] = self.sections.in_frame(frame, &seeds[index]).map(|v| v * frame.chord);
            let on_a = section.cos * sa - section.sin * sb;
            let on_b = section.sin * sa + section.cos * sb;
            for axis in 0..3 {
                on[SHIFT + axis] += seeds[index][axis];
            }
            on[TWIST] += b * sa - a * sb;
            on[STRETCH] += along * on_a + section.bulge(i, layer) * on_b;
            on[THICKNESS_STRETCH] += across * on_b;
            let on_bulge = (1.0 + section.values[STRETCH]) * on_b;
            on[CAMBER + i] += on_bulge;
            on[CAMBER + self.along.len() + i] += layer * on_bulge;
        });
        on
    }

    /// The quantities by section.
    fn turned<'a, T: Scalar>(&self, quantities: &'a [T]) -> Vec<Turned<'a, T>> {
        let sections = quantities.chunks_exact(self.slots());
        sections.map(|values| Turned::new(values, self.along.len())).collect()
    }

    /// Calls `visit` with the index of each lattice point and its i (chord), k (section), j (layer).
    fn each(&self, mut visit: impl FnMut(usize, usize, usize, usize)) {
        let mut index = 0;
        for i in 0..self.along.len() {
            for k in 0..self.sections.frames.len() {
                for j in 0..self.across.len() {
                    visit(index, i, k, j);
                    index += 1;
                }
            }
        }
    }

    /// A vector for each lattice point, of its i, k, j.
    fn each_point<T: Scalar>(
        &self,
        vector: impl Fn(usize, usize, usize) -> nalgebra::Vector3<T>,
    ) -> Vec<nalgebra::Vector3<T>> {
        let mut lattice = Vec::with_capacity(self.len());
        self.each(|_, i, k, j| lattice.push(vector(i, k, j)));
        lattice
    }
}
