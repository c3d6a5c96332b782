//! Bezier pieces of patches and what is provable about them: boxes, and bounds of the derivatives.
//!
//! A point of a Bezier patch is a convex combination of its control points (of their Cartesian positions, for positive
//! weights), and so are its derivatives of the differences of the control points. From that follow an oriented box around
//! the piece and, for the squared distance to a given point, a proof that it is convex over the piece.

use crate::Vector3;
use moldline_spline::{LinearRow, MAX_DEGREE, Surface};

const SIDE: usize = MAX_DEGREE + 1;

/// Homogeneous Bezier control points over a parameter rectangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Net {
    p: usize,
    q: usize,
    /// Index `i (q + 1) + j`.
    points: [[f64; 4]; SIDE * SIDE],
}

impl Net {
    /// The piece of a patch over a rectangle within one knot interval in each direction.
    pub fn new(surface: &Surface, control_points: &[[f64; 4]], [u, v]: [(f64, f64); 2]) -> Self {
        let rows = |knots: &moldline_spline::KnotVector, (a, b): (f64, f64)| {
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
        };
        let (p, q) = (surface.knots_u().degree(), surface.knots_v().degree());
        let rows_u = rows(surface.knots_u(), u);
        let rows_v = rows(surface.knots_v(), v);
        let n_v = surface.knots_v().control_point_count();
        let mut half = [[0.0; 4]; SIDE * SIDE];
        for i in 0..=p {
            let start = (rows_u[0].first + i) * n_v + rows_v[0].first;
            let row = &control_points[start..start + q + 1];
            for j in 0..=q {
                for (w, c) in rows_v[j].weights.iter().zip(row) {
                    for d in 0..4 {
                        half[i * (q + 1) + j][d] += w * c[d];
                    }
                }
            }
        }
        let mut points = [[0.0; 4]; SIDE * SIDE];
        for i in 0..=p {
            for k in 0..=p {
                let w = rows_u[i].weights[k];
                for j in 0..=q {
                    for d in 0..4 {
                        points[i * (q + 1) + j][d] += w * half[k * (q + 1) + j][d];
                    }
                }
            }
        }
        Self { p, q, points }
    }

    pub fn points(&self) -> &[[f64; 4]] {
        &self.points[..(self.p + 1) * (self.q + 1)]
    }

    /// The two halves along `u` or `v`, by de Casteljau's construction.
    pub fn halves(&self, along_u: bool) -> [Self; 2] {
        let (mut low, mut high) = (*self, *self);
        let (n, count, stride, other) =
            if along_u { (self.p, self.q + 1, self.q + 1, 1) } else { (self.q, self.p + 1, 1, self.q + 1) };
        for line in 0..count {
            let at = |k: usize| line * other + k * stride;
            for level in 1..=n {
                // `high` holds the current column of the triangle; its first entries are final for `low`.
                for k in 0..=n - level {
                    let (a, b) = (high.points[at(k)], high.points[at(k + 1)]);
                    high.points[at(k)] = std::array::from_fn(|d| 0.5 * (a[d] + b[d]));
                }
                low.points[at(level)] = high.points[at(0)];
            }
        }
        [low, high]
    }

    fn difference(&self, along_u: bool) -> Self {
        let (p, q) = if along_u { (self.p - 1, self.q) } else { (self.p, self.q - 1) };
        // Derivatives are with respect to a parameter that runs from -1 to 1.
        let factor = 0.5 * if along_u { self.p } else { self.q } as f64;
        let step = if along_u { self.q + 1 } else { 1 };
        let mut points = [[0.0; 4]; SIDE * SIDE];
        for i in 0..=p {
            for j in 0..=q {
                let k = i * (self.q + 1) + j;
                let (a, b) = (self.points[k], self.points[k + step]);
                points[i * (q + 1) + j] = std::array::from_fn(|d| factor * (b[d] - a[d]));
            }
        }
        Self { p, q, points }
    }

    /// The homogeneous point in the middle.
    fn middle(&self) -> [f64; 4] {
        let bernstein = |n: usize| {
            let mut b = [0.0; SIDE];
            b[0] = 0.5f64.powi(n as i32);
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
                    sum[d] += w * self.points[i * (self.q + 1) + j][d];
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
}

fn xyz(h: &[f64; 4]) -> Vector3 {
    Vector3::new(h[0], h[1], h[2])
}

/// Cartesian position of a homogeneous point.
pub(crate) fn position(h: &[f64; 4]) -> Vector3 {
    if h[3] == 1.0 { xyz(h) } else { xyz(h) / h[3] }
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
    pub fn new(net: &Net, rational: bool) -> Self {
        let zero = Net { p: 0, q: 0, points: [[0.0; 4]; SIDE * SIDE] };
        let derive = |n: &Net, along_u: bool| {
            if (along_u && n.p == 0) || (!along_u && n.q == 0) { zero } else { n.difference(along_u) }
        };
        let n_u = derive(net, true);
        let n_v = derive(net, false);
        let n_uu = derive(&n_u, true);
        let n_uv = derive(&n_u, false);
        let n_vv = derive(&n_v, false);
        let third = [derive(&n_uu, true), derive(&n_uu, false), derive(&n_vv, true), derive(&n_vv, false)];

        let s = net.middle();
        let center = position(&s);
        let (h_u, h_v) = (n_u.middle(), n_v.middle());
        let quotient = |h: &[f64; 4], rest: Vector3| (xyz(h) - rest) / s[3];
        let (d_u, d_v, d_uu, d_uv, d_vv);
        if rational {
            d_u = quotient(&h_u, center * h_u[3]);
            d_v = quotient(&h_v, center * h_v[3]);
            let second = |n: &Net, (a, sa): (&[f64; 4], &Vector3), (b, sb): (&[f64; 4], &Vector3)| {
                let h = n.middle();
                quotient(&h, sb * a[3] + sa * b[3] + center * h[3])
            };
            d_uu = second(&n_uu, (&h_u, &d_u), (&h_u, &d_u));
            d_uv = second(&n_uv, (&h_u, &d_u), (&h_v, &d_v));
            d_vv = second(&n_vv, (&h_v, &d_v), (&h_v, &d_v));
        } else {
            (d_u, d_v) = (xyz(&h_u), xyz(&h_v));
            (d_uu, d_uv, d_vv) = (xyz(&n_uu.middle()), xyz(&n_uv.middle()), xyz(&n_vv.middle()));
        }

        let mut radius = 0.0f64;
        let mut least_weight = f64::INFINITY;
        for h in net.points() {
            radius = radius.max((position(h) - center).norm_squared());
            least_weight = least_weight.min(h[3]);
        }
        let radius = radius.sqrt();

        // Bounds over the piece. With S - c = Q / w Leibniz' rule gives, order by order,
        // |S_a| <= (|Q_a| + sum over 0 < b <= a of binomial(a, b) |w_b| |S_(a-b)|) / min w.
        let bound = |n: &Net| n.bounds(&center);
        let ((q_u, w_u), (q_v, w_v)) = (bound(&n_u), bound(&n_v));
        let ((q_uu, w_uu), (q_uv, w_uv), (q_vv, w_vv)) = (bound(&n_uu), bound(&n_uv), bound(&n_vv));
        let [t_uuu, t_uuv, t_uvv, t_vvv] = [0, 1, 2, 3].map(|k| bound(&third[k]));
        let (m_uu, m_uv, m_vv, m_uuu, m_uuv, m_uvv, m_vvv);
        if rational {
            let w = least_weight;
            let m_u = (q_u + w_u * radius) / w;
            let m_v = (q_v + w_v * radius) / w;
            m_uu = (q_uu + 2.0 * w_u * m_u + w_uu * radius) / w;
            m_uv = (q_uv + w_u * m_v + w_v * m_u + w_uv * radius) / w;
            m_vv = (q_vv + 2.0 * w_v * m_v + w_vv * radius) / w;
            m_uuu = (t_uuu.0 + 3.0 * w_u * m_uu + 3.0 * w_uu * m_u + t_uuu.1 * radius) / w;
            m_uuv =
                (t_uuv.0 + 2.0 * w_u * m_uv + w_v * m_uu + w_uu * m_v + 2.0 * w_uv * m_u + t_uuv.1 * radius)
                    / w;
            m_uvv =
                (t_uvv.0 + 2.0 * w_v * m_uv + w_u * m_vv + w_vv * m_u + 2.0 * w_uv * m_v + t_uvv.1 * radius)
                    / w;
            m_vvv = (t_vvv.0 + 3.0 * w_v * m_vv + 3.0 * w_vv * m_v + t_vvv.1 * radius) / w;
        } else {
            (m_uu, m_uv, m_vv) = (q_uu, q_uv, q_vv);
            (m_uuu, m_uuv, m_uvv, m_vvv) = (t_uuu.0, t_uuv.0, t_uvv.0, t_vvv.0);
        }

        // Differences of control points carry the rounding of their coordinates, which matters for tiny pieces.
        let lost = 4.0 * f64::EPSILON * (net.p.max(net.q) as f64).powi(2) * (center.amax() + radius);
        let axes = frame(&d_u, &d_v);
        let mut low = Vector3::repeat(f64::INFINITY);
        let mut high = -low;
        for h in net.points() {
            let p = position(h) - center;
            let local = Vector3::new(axes[0].dot(&p), axes[1].dot(&p), axes[2].dot(&p));
            low = low.inf(&local);
            high = high.sup(&local);
        }
        let m = (low + high) * 0.5;
        let half = (high - low) * 0.5;
        Self {
            axes,
            middle: center + axes[0] * m.x + axes[1] * m.y + axes[2] * m.z,
            half: half.into(),
            center,
            radius,
            d: [d_u, d_v],
            dd: [d_uu, d_uv, d_vv],
            lengths: [d_u.norm(), d_v.norm()],
            lengths2: [d_uu.norm(), d_uv.norm(), d_vv.norm()],
            stray: [m_uu + m_uv + lost, m_uv + m_vv + lost],
            stray2: [m_uuu + m_uuv + lost, m_uuv + m_uvv + lost, m_uvv + m_vvv + lost],
            bend: [m_uu, m_vv],
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

    /// Whether `|S - x|^2` is proven to be convex over the piece: its Hessian `S_a . S_b + S_ab . (S - x)` is positive
    /// definite in the middle with a margin larger than it can change over the piece.
    #[inline]
    pub fn is_convex_for(&self, x: &Vector3) -> bool {
        let r = self.center - x;
        let reach = r.norm() + self.radius;
        let [lu, lv] = self.lengths;
        let [eu, ev] = self.stray;
        let change = |k: usize| self.stray2[k] * reach + self.lengths2[k] * self.radius;
        let (su, sv) = ((lu - eu).max(0.0), (lv - ev).max(0.0));
        let huu = su * su + self.dd[0].dot(&r) - change(0);
        let hvv = sv * sv + self.dd[2].dot(&r) - change(2);
        let huv =
            (self.d[0].dot(&self.d[1]) + self.dd[1].dot(&r)).abs() + lu * ev + lv * eu + eu * ev + change(1);
        huu > 0.0 && hvv > 0.0 && huu * hvv > huv * huv
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
