//! Bezier pieces of patches, with boxes and bounds of the derivatives.
//!
//! A point of a Bezier patch is a convex combination of its control points (of their Cartesian positions, for positive
//! weights), and its derivatives are convex combinations of differences of the control points. From that follow an oriented
//! box around the piece and, for the squared distance to a given point, a proof that it is convex over the piece.

use crate::location::Rectangle;
use moldline_foundation::Vector3;
use moldline_spline::{KnotVector, LinearRow, MAX_DEGREE, Surface};

/// Enough for every degree.
pub(crate) const SIDE: usize = MAX_DEGREE + 1;

/// Homogeneous Bezier control points over a parameter rectangle, for degrees below `N`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Net<const N: usize> {
    p: usize,
    q: usize,
    rows: [[[f64; 4]; N]; N],
}

impl<const N: usize> Net<N> {
    const ZERO: Self = Self { p: 0, q: 0, rows: [[[0.0; 4]; N]; N] };

    /// The piece of a patch over a rectangle within one knot interval in each direction.
    pub fn new(surface: &Surface, control_points: &[[f64; 4]], [u, v]: [(f64, f64); 2]) -> Self {
        let (p, q) = (surface.knots_u().degree(), surface.knots_v().degree());
        let rows_u = bezier_rows(surface.knots_u(), u);
        let rows_v = bezier_rows(surface.knots_v(), v);
        let n_v = surface.knots_v().control_point_count();
        let mut half = [[[0.0; 4]; N]; N];
        for i in 0..=p {
            let start = (rows_u[0].first + i) * n_v + rows_v[0].first;
            let row = &control_points[start..start + q + 1];
            for j in 0..=q {
                for (w, c) in rows_v[j].weights.iter().zip(row) {
                    for d in 0..4 {
                        half[i][j][d] += w * c[d];
                    }
                }
            }
        }
        let mut net = Self { p, q, ..Self::ZERO };
        for i in 0..=p {
            for k in 0..=p {
                let w = rows_u[i].weights[k];
                for j in 0..=q {
                    for d in 0..4 {
                        net.rows[i][j][d] += w * half[k][j][d];
                    }
                }
            }
        }
        net
    }

    pub fn points(&self) -> impl Iterator<Item = &[f64; 4]> {
        self.rows[..=self.p].iter().flat_map(|row| &row[..=self.q])
    }

    /// The two halves along `u` or `v`, by de Casteljau's construction.
    pub fn halves(&self, along_u: bool) -> [Self; 2] {
        let (mut low, mut high) = (*self, *self);
        let middle = |a: &[f64; 4], b: &[f64; 4]| std::array::from_fn(|d| 0.5 * (a[d] + b[d]));
        // `high` holds the current column of the triangle; its first entries are final for `low`.
        if along_u {
            for level in 1..=self.p {
                for i in 0..=self.p - level {
                    for j in 0..=self.q {
                        high.rows[i][j] = middle(&high.rows[i][j], &high.rows[i + 1][j]);
                    }
                }
                low.rows[level] = high.rows[0];
            }
        } else {
            for (low, high) in low.rows.iter_mut().zip(&mut high.rows).take(self.p + 1) {
                for level in 1..=self.q {
                    for j in 0..=self.q - level {
                        high[j] = middle(&high[j], &high[j + 1]);
                    }
                    low[level] = high[0];
                }
            }
        }
        [low, high]
    }

    /// The net of a side, or of a corner: of the part of the piece's rectangle that has no extent where the piece has.
    pub fn restricted(&self, [u, v]: Rectangle, [part_u, part_v]: Rectangle) -> Self {
        let mut out = *self;
        if part_u.0 == part_u.1 {
            out.rows[0] = self.rows[if part_u.0 == u.0 { 0 } else { self.p }];
            out.p = 0;
        }
        if part_v.0 == part_v.1 {
            let j = if part_v.0 == v.0 { 0 } else { self.q };
            for row in &mut out.rows[..=out.p] {
                row[0] = row[j];
            }
            out.q = 0;
        }
        out
    }

    /// The derivative with respect to a parameter that runs from -1 to 1; zero for degree 0.
    fn derivative(&self, along_u: bool) -> Self {
        let n = if along_u { self.p } else { self.q };
        if n == 0 {
            return Self::ZERO;
        }
        let factor = 0.5 * n as f64;
        let (du, dv) = (usize::from(along_u), usize::from(!along_u));
        let mut out = Self { p: self.p - du, q: self.q - dv, ..Self::ZERO };
        for i in 0..=out.p {
            for j in 0..=out.q {
                let (a, b) = (&self.rows[i][j], &self.rows[i + du][j + dv]);
                out.rows[i][j] = std::array::from_fn(|d| factor * (b[d] - a[d]));
            }
        }
        out
    }

    /// The homogeneous point in the middle.
    fn middle(&self) -> [f64; 4] {
        let bernstein = |n: usize| {
            let mut b = [0.0; N];
            b[0] = 1.0 / (1u32 << n) as f64;
            for i in 1..=n {
                b[i] = b[i - 1] * (n + 1 - i) as f64 / i as f64;
            }
            b
        };
        let (bu, bv) = (bernstein(self.p), bernstein(self.q));
        let mut sum = [0.0; 4];
        for i in 0..=self.p {
            for j in 0..=self.q {
                let w = bu[i] * bv[j];
                for d in 0..4 {
                    sum[d] += w * self.rows[i][j][d];
                }
            }
        }
        sum
    }

    /// Largest norm of `P - w c` and largest `|w|` over the control points.
    fn bounds(&self, c: &Vector3) -> (f64, f64) {
        let (mut vector, mut weight) = (0.0f64, 0.0f64);
        for h in self.points() {
            vector = vector.max((xyz(h) - c * h[3]).norm_squared());
            weight = weight.max(h[3].abs());
        }
        (vector.sqrt(), weight)
    }

    /// Smallest and largest coordinates of the control points about `center`, along three axes.
    fn extent(&self, center: &Vector3, axes: &[Vector3; 3]) -> (Vector3, Vector3) {
        let mut low = Vector3::repeat(f64::INFINITY);
        let mut high = -low;
        for h in self.points() {
            let p = position(h) - center;
            let local = Vector3::new(axes[0].dot(&p), axes[1].dot(&p), axes[2].dot(&p));
            low = low.inf(&local);
            high = high.sup(&local);
        }
        (low, high)
    }
}

/// The rows that give the Bezier control points over an interval within one knot interval.
fn bezier_rows(knots: &KnotVector, (a, b): (f64, f64)) -> [LinearRow; SIDE] {
    let p = knots.degree();
    let interval = knots.interval(0.5 * (a + b));
    let mut arguments = [a; MAX_DEGREE];
    let mut rows = [LinearRow { first: 0, count: 0, weights: [0.0; SIDE] }; SIDE];
    for k in 0..=p {
        rows[k] = knots.blossom(interval, &arguments[..p]);
        if k < p {
            arguments[p - 1 - k] = b;
        }
    }
    rows
}

fn xyz(h: &[f64; 4]) -> Vector3 {
    Vector3::new(h[0], h[1], h[2])
}

/// Cartesian position of a homogeneous point.
pub(crate) fn position(h: &[f64; 4]) -> Vector3 {
    if h[3] == 1.0 { xyz(h) } else { xyz(h) / h[3] }
}

/// The nets of a piece's derivatives with respect to parameters from -1 to 1.
struct Derivatives<const N: usize> {
    /// `u`, `v`.
    first: [Net<N>; 2],
    /// `uu`, `uv`, `vv`.
    second: [Net<N>; 3],
    /// `uuu`, `uuv`, `uvv`, `vvv`.
    third: [Net<N>; 4],
}

impl<const N: usize> Derivatives<N> {
    fn new(net: &Net<N>) -> Self {
        let first = [net.derivative(true), net.derivative(false)];
        let second = [first[0].derivative(true), first[0].derivative(false), first[1].derivative(false)];
        let third = [(0, true), (0, false), (2, true), (2, false)].map(|(k, u)| second[k].derivative(u));
        Self { first, second, third }
    }

    /// `S_u, S_v` and `S_uu, S_uv, S_vv` in the middle, whose homogeneous point is `s`, by the quotient rule.
    fn in_the_middle(&self, s: &[f64; 4], center: &Vector3, rational: bool) -> ([Vector3; 2], [Vector3; 3]) {
        let [h_u, h_v] = [0, 1].map(|k| self.first[k].middle());
        let second = [0, 1, 2].map(|k| self.second[k].middle());
        if !rational {
            return ([xyz(&h_u), xyz(&h_v)], second.map(|h| xyz(&h)));
        }
        let quotient = |h: &[f64; 4], rest: Vector3| (xyz(h) - rest) / s[3];
        let d_u = quotient(&h_u, center * h_u[3]);
        let d_v = quotient(&h_v, center * h_v[3]);
        let [h_uu, h_uv, h_vv] = second;
        let d_uu = quotient(&h_uu, d_u * h_u[3] + d_u * h_u[3] + center * h_uu[3]);
        let d_uv = quotient(&h_uv, d_v * h_u[3] + d_u * h_v[3] + center * h_uv[3]);
        let d_vv = quotient(&h_vv, d_v * h_v[3] + d_v * h_v[3] + center * h_vv[3]);
        ([d_u, d_v], [d_uu, d_uv, d_vv])
    }

    /// Bounds of the lengths of the second and of the third derivatives over the piece, which lies within `radius` of
    /// `center`. `least_weight` is that of the control points if the piece is rational.
    ///
    /// With `S - c = Q / w` Leibniz' rule gives, order by order,
    /// `|S_a| <= (|Q_a| + sum over 0 < b <= a of binomial(a, b) |w_b| |S_(a-b)|) / min w`.
    fn bounds(&self, center: &Vector3, radius: f64, least_weight: Option<f64>) -> ([f64; 3], [f64; 4]) {
        let [uu, uv, vv] = [0, 1, 2].map(|k| self.second[k].bounds(center));
        let [uuu, uuv, uvv, vvv] = [0, 1, 2, 3].map(|k| self.third[k].bounds(center));
        let Some(w) = least_weight else {
            return ([uu.0, uv.0, vv.0], [uuu.0, uuv.0, uvv.0, vvv.0]);
        };
        let [(q_u, w_u), (q_v, w_v)] = [0, 1].map(|k| self.first[k].bounds(center));
        let ((q_uu, w_uu), (q_uv, w_uv), (q_vv, w_vv)) = (uu, uv, vv);
        let m_u = (q_u + w_u * radius) / w;
        let m_v = (q_v + w_v * radius) / w;
        let m_uu = (q_uu + 2.0 * w_u * m_u + w_uu * radius) / w;
        let m_uv = (q_uv + w_u * m_v + w_v * m_u + w_uv * radius) / w;
        let m_vv = (q_vv + 2.0 * w_v * m_v + w_vv * radius) / w;
        let m_uuu = (uuu.0 + 3.0 * w_u * m_uu + 3.0 * w_uu * m_u + uuu.1 * radius) / w;
        let m_uuv =
            (uuv.0 + 2.0 * w_u * m_uv + w_v * m_uu + w_uu * m_v + 2.0 * w_uv * m_u + uuv.1 * radius) / w;
        let m_uvv =
            (uvv.0 + 2.0 * w_v * m_uv + w_u * m_vv + w_vv * m_u + 2.0 * w_uv * m_v + uvv.1 * radius) / w;
        let m_vvv = (vvv.0 + 3.0 * w_v * m_vv + 3.0 * w_vv * m_v + vvv.1 * radius) / w;
        ([m_uu, m_uv, m_vv], [m_uuu, m_uuv, m_uvv, m_vvv])
    }
}

/// A piece's oriented box, its Taylor expansion about the middle in parameters from -1 to 1, and bounds of how far the
/// derivatives stray from it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    axes: [Vector3; 3],
    middle: Vector3,
    half: [f64; 3],
    /// The point in the middle of the parameter rectangle.
    pub center: Vector3,
    /// No point of the piece is further from `center`.
    pub radius: f64,
    d: [Vector3; 2],
    dd: [Vector3; 3],
    lengths: [f64; 2],
    lengths2: [f64; 3],
    /// Bounds of `|S_a - S_a(middle)|`.
    stray: [f64; 2],
    /// Bounds of `|S_ab - S_ab(middle)|`.
    stray2: [f64; 3],
    /// Bounds of `|S_uu|` and `|S_vv|`: how far the piece bends in each direction.
    bend: [f64; 2],
}

impl Shape {
    pub fn new<const N: usize>(net: &Net<N>, rational: bool) -> Self {
        let derivatives = Derivatives::new(net);
        let homogeneous = net.middle();
        let center = position(&homogeneous);
        let (d, dd) = derivatives.in_the_middle(&homogeneous, &center, rational);
        let (mut radius, mut least_weight) = (0.0f64, f64::INFINITY);
        for h in net.points() {
            radius = radius.max((position(h) - center).norm_squared());
            least_weight = least_weight.min(h[3]);
        }
        let radius = radius.sqrt();
        let ([uu, uv, vv], [uuu, uuv, uvv, vvv]) =
            derivatives.bounds(&center, radius, rational.then_some(least_weight));
        // Differences of control points carry the rounding of their coordinates, which matters for tiny pieces.
        let lost = 4.0 * f64::EPSILON * (net.p.max(net.q) as f64).powi(2) * (center.amax() + radius);
        let axes = frame(&d[0], &d[1]);
        let (low, high) = net.extent(&center, &axes);
        let (m, half) = ((low + high) * 0.5, (high - low) * 0.5);
        Self {
            axes,
            middle: center + axes[0] * m.x + axes[1] * m.y + axes[2] * m.z,
            half: half.into(),
            center,
            radius,
            d,
            dd,
            lengths: d.map(|d| d.norm()),
            lengths2: dd.map(|dd| dd.norm()),
            stray: [uu + uv + lost, uv + vv + lost],
            stray2: [uuu + uuv + lost, uuv + uvv + lost, uvv + vvv + lost],
            bend: [uu, vv],
        }
    }

    /// Square of a lower bound of the distance from `x` to the piece: the distance to its oriented box.
    #[inline]
    pub fn squared_distance(&self, x: &Vector3) -> f64 {
        let r = x - self.middle;
        let mut sum = 0.0;
        for k in 0..3 {
            let d = (self.axes[k].dot(&r).abs() - self.half[k]).max(0.0);
            sum += d * d;
        }
        sum
    }

    /// The part of the piece, given by its parameter rectangle, that is proven to contain a minimum of `|S - x|^2` over
    /// the piece, and whether `|S - x|^2` is proven to be convex over that part. With `f = |S - x|^2 / 2`:
    /// - the part is a side, or a corner, if the gradient `S_a . (S - x)` keeps its sign over the piece;
    /// - `f` is convex if the Hessian `S_a . S_b + S_ab . (S - x)` is positive definite in the middle with a margin
    ///   larger than it can change over the piece; along a side one diagonal entry is enough.
    #[inline]
    pub fn minimum_part(&self, x: &Vector3, [u, v]: Rectangle) -> (Rectangle, bool) {
        let r = self.center - x;
        let reach = r.norm() + self.radius;
        let [lu, lv] = self.lengths;
        let [eu, ev] = self.stray;
        let change = |k: usize| self.stray2[k] * reach + self.lengths2[k] * self.radius;
        let (cu, cuv, cv) = (change(0), change(1), change(2));
        let bend = [self.dd[0].dot(&r), self.dd[1].dot(&r), self.dd[2].dot(&r)];
        // Largest |f_uu|, |f_vv|, |f_uv| over the piece, whose parameters are at most 1 from the middle.
        let fuu = (lu * lu + bend[0]).abs() + 2.0 * lu * eu + eu * eu + cu;
        let fvv = (lv * lv + bend[2]).abs() + 2.0 * lv * ev + ev * ev + cv;
        let fuv = (self.d[0].dot(&self.d[1]) + bend[1]).abs() + lu * ev + lv * eu + eu * ev + cuv;
        let (gu, gv) = (self.d[0].dot(&r), self.d[1].dot(&r));
        let side = |g: f64, change: f64, (low, high): (f64, f64)| match g {
            _ if g.abs() < change => (low, high),
            _ if g > 0.0 => (low, low),
            _ => (high, high),
        };
        let (u, v) = (side(gu, fuu + fuv, u), side(gv, fvv + fuv, v));
        let (su, sv) = ((lu - eu).max(0.0), (lv - ev).max(0.0));
        let huu = su * su + bend[0] - cu;
        let hvv = sv * sv + bend[2] - cv;
        let convex = match (u.0 == u.1, v.0 == v.1) {
            (true, true) => true,
            (true, false) => hvv > 0.0,
            (false, true) => huu > 0.0,
            (false, false) => huu > 0.0 && hvv > 0.0 && huu * hvv > fuv * fuv,
        };
        ([u, v], convex)
    }

    /// Whether the piece should rather be cut along `u` than along `v`: the direction in which it bends more, or is
    /// much longer.
    pub fn cut_along_u(&self) -> bool {
        self.bend[0] + 0.1 * self.lengths[0] >= self.bend[1] + 0.1 * self.lengths[1]
    }

    /// How strongly the tangents turn over the piece, relative to their lengths.
    pub fn turning(&self) -> f64 {
        (self.stray[0] / self.lengths[0]).max(self.stray[1] / self.lengths[1])
    }
}

/// An orthonormal frame with its first two axes along the tangents, as far as they are independent.
fn frame(d_u: &Vector3, d_v: &Vector3) -> [Vector3; 3] {
    let first = if d_u.norm_squared() >= d_v.norm_squared() { d_u } else { d_v };
    let Some(a) = first.try_normalize(0.0) else { return [Vector3::x(), Vector3::y(), Vector3::z()] };
    let normal = d_u.cross(d_v);
    let scale = d_u.norm() * d_v.norm();
    let c = if normal.norm() > 1e-6 * scale {
        // The product of nearly parallel tangents is not quite perpendicular to them.
        let c = normal.normalize();
        (c - a * a.dot(&c)).normalize()
    } else {
        // Any direction across: the one nearest to an axis.
        let mut axis = Vector3::zeros();
        axis[a.iamin()] = 1.0;
        (axis - a * a.dot(&axis)).normalize()
    };
    [a, c.cross(&a), c]
}
