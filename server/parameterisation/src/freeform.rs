//! Free-form deformation (paper II.A, eqs. 3 and 4) with a lattice organised by spanwise sections.
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
//! iteration. A control point moves by F(xi; B*) - F(xi; B0), so the baseline is reproduced exactly.

use moldline_spline::{KnotVector, Vector3, Volume};
use nalgebra::convert;

use crate::parameterisation::shift;
use crate::sections::{Axes, SampledSurfaces, Section};
use crate::{FreeFormDeclaration, ParameterisationError, Scalar};

/// Sections thinner than this fraction of the largest chord get this chord, so that their frames stay well defined
/// (a pointed tip).
const SMALLEST_CHORD: f64 = 0.05;
/// Width of the lattice, in chords, where the embedded points have none (a flat plate).
const SMALLEST_WIDTH: f64 = 0.02;
/// Lattice points, and weights of embedded points, that a block may have.
const LATTICE_LIMIT: usize = 200_000;
const WEIGHT_LIMIT: usize = 50_000_000;

/// Slots of a section's quantities: chi, chi', shift x y z, twist, then camber and thickness of each row.
pub(crate) const STRETCH: usize = 0;
pub(crate) const THICKNESS_STRETCH: usize = 1;
pub(crate) const SHIFT: usize = 2;
pub(crate) const TWIST: usize = 5;
pub(crate) const CAMBER: usize = 6;

/// A design variable's linear effect on one slot.
#[derive(Clone, Debug)]
pub(crate) struct Influence {
    pub(crate) slot: usize,
    pub(crate) variable: usize,
    pub(crate) baseline: f64,
    /// Includes the unit.
    pub(crate) weight: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct FreeForm {
    axes: Axes,
    volume: Volume,
    stations: Vec<f64>,
    frames: Vec<Frame>,
    /// a_i, t_j and sigma_j.
    along: Vec<f64>,
    across: Vec<f64>,
    layer: Vec<f64>,
    pub(crate) influences: Vec<Influence>,
    targets: Vec<usize>,
    /// Targets on the plane of symmetry, which they do not leave, not even by rounding.
    on_plane: Vec<bool>,
    /// The weights of target m are `weights[offsets[m]..offsets[m + 1]]`: lattice index and value.
    offsets: Vec<usize>,
    weights: Vec<(u32, f64)>,
}

/// Quarter chord, c e and c, with two components: chord axis, thickness axis.
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

    /// The same after it: positive twist takes the trailing edge down.
    fn turn(&self, [a, b]: [T; 2]) -> [T; 2] {
        [self.cos * a + self.sin * b, self.cos * b - self.sin * a]
    }
}

impl FreeForm {
    /// A block around `targets` (indices into `points`); the first `embedded` of them span the lattice, further ones
    /// (points carried along) take the displacement of the closest place in it.
    pub(crate) fn new(
        field: &str,
        declaration: &FreeFormDeclaration,
        surfaces: &SampledSurfaces,
        points: &[Vector3],
        targets: Vec<usize>,
        embedded: usize,
    ) -> Result<Self, ParameterisationError> {
        let n_span = declaration.shape[1];
        let points_in_lattice = declaration
            .shape
            .iter()
            .try_fold(1, |product: usize, &n| product.checked_mul(n))
            .unwrap_or(usize::MAX);
        limit(format!("{field}.shape (product)"), points_in_lattice, LATTICE_LIMIT)?;
        let per_point: usize = declaration.degree.iter().map(|&p| p.min(LATTICE_LIMIT) + 1).product();
        limit(format!("{field}.degree (weights)"), per_point.saturating_mul(targets.len()), WEIGHT_LIMIT)?;
        let knots = |d: usize| {
            KnotVector::clamped_uniform(declaration.degree[d], declaration.shape[d]).map_err(|source| {
                ParameterisationError::Knots { field: format!("{field}.shape[{d}]"), source }
            })
        };
        let volume = Volume::new([knots(0)?, knots(1)?, knots(2)?]);
        let [greville_along, greville_span, greville_across] =
            [0, 1, 2].map(|d| volume.knots()[d].greville());

        let axes = Axes::of_span(declaration.span);
        let geometry =
            |reason: &str| ParameterisationError::Geometry { field: field.into(), reason: reason.into() };
        let (low, high) = targets[..embedded]
            .iter()
            .map(|&i| points[i][axes.span])
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
        let (low, high) = if declaration.symmetric {
            let reach = low.abs().max(high.abs());
            (-reach, reach)
        } else {
            (low, high)
        };
        if low >= high {
            return Err(geometry("the embedded components have no extent along the span axis"));
        }
        let mut stations: Vec<f64> = greville_span.iter().map(|g| low + (high - low) * g).collect();
        if declaration.symmetric {
            // Exactly, so that a symmetric component stays symmetric to the last bit.
            for k in 0..n_span / 2 {
                stations[k] = -stations[n_span - 1 - k];
            }
            if n_span % 2 == 1 {
                stations[n_span / 2] = 0.0;
            }
        }
        let sections = stations
            .iter()
            .map(|&station| surfaces.section(axes, station, declaration.symmetric))
            .collect::<Option<Vec<Section>>>()
            .ok_or_else(|| geometry("a section has no chord: is the span axis right?"))?;
        let largest = sections.iter().map(|s| s.chord[0].hypot(s.chord[1])).fold(0.0, f64::max);
        let frames: Vec<Frame> = sections.iter().map(|s| Frame::new(s, SMALLEST_CHORD * largest)).collect();

        // Coordinates of every target: xi_2 from the span, then (a, t) in the section frame interpolated there. In a
        // mirrored block the port side takes those of its image, so that both sides get the same bits.
        let mirrored = |point: &Vector3| declaration.symmetric && point[axes.span] < 0.0;
        let located: Vec<(f64, f64, f64)> = targets
            .iter()
            .map(|&target| {
                let point = points[target];
                let station = if mirrored(&point) { -point[axes.span] } else { point[axes.span] };
                let xi = ((station - low) / (high - low)).clamp(0.0, 1.0);
                let basis = volume.knots()[1].basis(xi, 0);
                let (mut origin, mut chord) = ([0.0; 2], [0.0; 2]);
                for (frame, weight) in frames[basis.first..].iter().zip(basis.value()) {
                    for a in 0..2 {
                        origin[a] += weight * frame.quarter_chord[a];
                        chord[a] += weight * frame.chord * frame.direction[a];
                    }
                }
                let d = [point[axes.chord] - origin[0], point[axes.thickness] - origin[1]];
                let square = chord[0] * chord[0] + chord[1] * chord[1];
                let a = (d[0] * chord[0] + d[1] * chord[1]) / square;
                let t = (d[1] * chord[0] - d[0] * chord[1]) / square;
                (a, xi, t)
            })
            .collect();
        let width = |coordinate: fn(&(f64, f64, f64)) -> f64| {
            let (low, high) = located[..embedded]
                .iter()
                .map(coordinate)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), c| (low.min(c), high.max(c)));
            let missing = (0.5 * (SMALLEST_WIDTH - (high - low))).max(0.0);
            (low - missing, high + missing)
        };
        let (first, last) = width(|c| c.0);
        let (lowest, uppermost) = width(|c| c.2);
        let along: Vec<f64> = greville_along.iter().map(|g| first + (last - first) * g).collect();
        let across: Vec<f64> = greville_across.iter().map(|g| lowest + (uppermost - lowest) * g).collect();
        let layer = greville_across.iter().map(|g| 2.0 * g - 1.0).collect();

        let mut offsets = vec![0];
        let mut weights = Vec::with_capacity(per_point * targets.len());
        for (&target, (a, xi, t)) in targets.iter().zip(located) {
            let xi = [(a - first) / (last - first), xi, (t - lowest) / (uppermost - lowest)];
            let mirrored = mirrored(&points[target]);
            for (index, weight) in volume.weights(xi, 0).entries().filter(|&(_, weight)| weight != 0.0) {
                let (row, layer) = (index / across.len(), index % across.len());
                let (i, k) = (row / n_span, row % n_span);
                let k = if mirrored { n_span - 1 - k } else { k };
                weights.push((((i * n_span + k) * across.len() + layer) as u32, weight));
            }
            offsets.push(weights.len());
        }
        let on_plane =
            targets.iter().map(|&i| declaration.symmetric && points[i][axes.span] == 0.0).collect();
        Ok(Self {
            axes,
            volume,
            stations,
            frames,
            along,
            across,
            layer,
            influences: Vec::new(),
            targets,
            on_plane,
            offsets,
            weights,
        })
    }

    /// Stations of the sections along the span axis, m.
    pub(crate) fn stations(&self) -> &[f64] {
        &self.stations
    }

    /// Slots per section.
    pub(crate) fn slots(&self) -> usize {
        CAMBER + 2 * self.along.len()
    }

    /// Numbers of lattice points along chord, span and thickness.
    pub(crate) fn shape(&self) -> [usize; 3] {
        self.volume.shape()
    }

    /// Lattice points of the reference block, index `(i n_span + k) n_across + j`.
    pub(crate) fn reference_lattice(&self) -> Vec<Vector3> {
        let mut lattice = vec![Vector3::zeros(); self.along.len() * self.frames.len() * self.across.len()];
        self.each(|index, i, k, j| {
            let frame = &self.frames[k];
            let mut point = self.in_space(frame, [self.along[i] * frame.chord, self.across[j] * frame.chord]);
            point[self.axes.span] += self.stations[k];
            point[self.axes.chord] += frame.quarter_chord[0];
            point[self.axes.thickness] += frame.quarter_chord[1];
            lattice[index] = point;
        });
        lattice
    }

    /// Calls `visit` with the index of each lattice point and its i (chord), k (section), j (layer).
    fn each(&self, mut visit: impl FnMut(usize, usize, usize, usize)) {
        let mut index = 0;
        for i in 0..self.along.len() {
            for k in 0..self.frames.len() {
                for j in 0..self.across.len() {
                    visit(index, i, k, j);
                    index += 1;
                }
            }
        }
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

    /// All slots of all sections.
    fn quantities<T: Scalar>(&self, design: &[T]) -> Vec<T> {
        let mut values = vec![T::zero(); self.slots() * self.frames.len()];
        for f in &self.influences {
            values[f.slot] += (design[f.variable] - convert(f.baseline)) * convert(f.weight);
        }
        values
    }

    /// B* - B0, exactly zero at the baseline.
    pub(crate) fn lattice_displacement<T: Scalar>(&self, design: &[T]) -> Vec<nalgebra::Vector3<T>> {
        let quantities = self.quantities(design);
        let sections: Vec<Turned<'_, T>> = quantities
            .chunks_exact(self.slots())
            .map(|values| Turned::new(values, self.along.len()))
            .collect();
        let count = self.along.len() * self.frames.len() * self.across.len();
        let mut lattice = vec![nalgebra::Vector3::zeros(); count];
        self.each(|index, i, k, j| {
            let (section, frame) = (&sections[k], &self.frames[k]);
            let [a, b] = section.turn(section.flat(i, self.along[i], self.across[j], self.layer[j]));
            let from_rest = [a - convert(self.along[i]), b - convert(self.across[j])];
            let step = from_rest.map(|d| d * convert(frame.chord));
            lattice[index] = nalgebra::Vector3::from_column_slice(&section.values[SHIFT..TWIST])
                + self.in_space(frame, step);
        });
        lattice
    }

    pub(crate) fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let lattice = self.lattice_displacement(design);
        for (step, &target) in self.interpolate(&lattice).zip(&self.targets) {
            shift(&mut points[target], step);
        }
    }

    pub(crate) fn jvp(&self, design: &[f64], direction: &[f64], tangents: &mut [Vector3]) {
        let quantities = self.quantities(design);
        let sections: Vec<Turned<'_, f64>> = quantities
            .chunks_exact(self.slots())
            .map(|values| Turned::new(values, self.along.len()))
            .collect();
        let mut change = vec![0.0; quantities.len()];
        for f in &self.influences {
            change[f.slot] += direction[f.variable] * f.weight;
        }
        let mut lattice = vec![Vector3::zeros(); self.along.len() * self.frames.len() * self.across.len()];
        self.each(|index, i, k, j| {
            let (section, frame) = (&sections[k], &self.frames[k]);
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
            lattice[index] = Vector3::from_column_slice(&d[SHIFT..TWIST]) + self.in_space(frame, step);
        });
        for (step, &target) in self.interpolate(&lattice).zip(&self.targets) {
            tangents[target] += step;
        }
    }

    pub(crate) fn vjp(&self, design: &[f64], seeds: &[Vector3], gradient: &mut [f64]) {
        let quantities = self.quantities(design);
        let sections: Vec<Turned<'_, f64>> = quantities
            .chunks_exact(self.slots())
            .map(|values| Turned::new(values, self.along.len()))
            .collect();
        let mut lattice = vec![Vector3::zeros(); self.along.len() * self.frames.len() * self.across.len()];
        for (m, &target) in self.targets.iter().enumerate() {
            for &(index, weight) in &self.weights[self.offsets[m]..self.offsets[m + 1]] {
                lattice[index as usize] += seeds[target] * weight;
            }
        }
        let mut on = vec![0.0; quantities.len()];
        self.each(|index, i, k, j| {
            let (section, frame) = (&sections[k], &self.frames[k]);
            let on = &mut on[k * self.slots()..(k + 1) * self.slots()];
            let (along, across, layer) = (self.along[i], self.across[j], self.layer[j]);
            let [a, b] = section.turn(section.flat(i, along, across, layer));
            let [sa, sb] = self.in_frame(frame, &lattice[index]).map(|v| v * frame.chord);
            let on_a = section.cos * sa - section.sin * sb;
            let on_b = section.sin * sa + section.cos * sb;
            for axis in 0..3 {
                on[SHIFT + axis] += lattice[index][axis];
            }
            on[TWIST] += b * sa - a * sb;
            on[STRETCH] += along * on_a + section.bulge(i, layer) * on_b;
            on[THICKNESS_STRETCH] += across * on_b;
            let on_bulge = (1.0 + section.values[STRETCH]) * on_b;
            on[CAMBER + i] += on_bulge;
            on[CAMBER + self.along.len() + i] += layer * on_bulge;
        });
        for f in &self.influences {
            gradient[f.variable] += on[f.slot] * f.weight;
        }
    }

    /// The lattice's field at each target.
    fn interpolate<'a, T: Scalar>(
        &'a self,
        lattice: &'a [nalgebra::Vector3<T>],
    ) -> impl Iterator<Item = nalgebra::Vector3<T>> + 'a {
        self.offsets.windows(2).zip(&self.on_plane).map(move |(w, &on_plane)| {
            let mut sum = nalgebra::Vector3::zeros();
            for &(index, weight) in &self.weights[w[0]..w[1]] {
                sum += lattice[index as usize] * convert::<f64, T>(weight);
            }
            if on_plane {
                sum[self.axes.span] = T::zero();
            }
            sum
        })
    }
}

fn limit(field: String, value: usize, highest: usize) -> Result<(), ParameterisationError> {
    if (1..=highest).contains(&value) {
        Ok(())
    } else {
        Err(ParameterisationError::OutOfRange { field, value, lowest: 1, highest })
    }
}
