//! Writers of aircraft files for tests. STEP in OpenVSP's layout: sets of loose surfaces by `ID, Name, SurfNo`, Bezier knots, collapsed caps,
//! mirrored copies as sets of their own.

use std::fmt::Write;

/// A patch: degrees, and rows of control points along u. Knots are those of Bezier pieces over 0, 1, 2, ...
#[derive(Clone)]
pub struct Bezier {
    pub degrees: [usize; 2],
    pub rows: Vec<Vec<[f64; 3]>>,
}

/// A set with its label.
pub type Set = (String, Vec<Bezier>);

/// The file, with a unit such as `SI_UNIT(.UNSET.,.METRE.)`.
pub fn step(sets: &[Set], unit: &str) -> String {
    let mut text = String::from(
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'1');\nFILE_SCHEMA(('CONFIG_CONTROL_DESIGN'));\nENDSEC;\nDATA;\n",
    );
    let _ = write!(
        text,
        "#1=(\nLENGTH_UNIT()\nNAMED_UNIT(*)\n{unit}\n);\n#2=(\nGEOMETRIC_REPRESENTATION_CONTEXT(3)\n\
         GLOBAL_UNIT_ASSIGNED_CONTEXT((#1))\nREPRESENTATION_CONTEXT('STANDARD','3D')\n);\n"
    );
    let mut next = 3;
    for (label, patches) in sets {
        let mut members = Vec::new();
        for patch in patches {
            members.push(format!("#{next}"));
            let surface = next;
            next += 1;
            let mut rows = Vec::new();
            let mut points = String::new();
            for row in &patch.rows {
                let mut names = Vec::new();
                for [x, y, z] in row {
                    let _ = writeln!(points, "#{next}=CARTESIAN_POINT('',({x:?},{y:?},{z:?}));");
                    names.push(format!("#{next}"));
                    next += 1;
                }
                rows.push(format!("({})", names.join(",")));
            }
            let [p, q] = patch.degrees;
            let (mu, ku) = knots(p, patch.rows.len());
            let (mv, kv) = knots(q, patch.rows[0].len());
            let _ = writeln!(
                text,
                "#{surface}=B_SPLINE_SURFACE_WITH_KNOTS('Surf_{label}',{p},{q},({}),.UNSPECIFIED.,.F.,.F.,.F.,{mu},{mv},{ku},{kv},\
                 .PIECEWISE_BEZIER_KNOTS.);",
                rows.join(",")
            );
            text += &points;
        }
        let _ = writeln!(text, "#{next}=GEOMETRIC_SET('{label}',({}));", members.join(","));
        next += 1;
    }
    text + "ENDSEC;\nEND-ISO-10303-21;\n"
}

/// The same patches as IGES in OpenVSP's layout: entities 128 and 406, with the last knot one too far, as OpenVSP has it.
pub fn iges(sets: &[Set], unit: &str) -> String {
    let mut directory: Vec<String> = Vec::new();
    let mut parameters: Vec<String> = Vec::new();
    let mut add = |kind: usize, form: usize, text: &str| {
        let number = directory.len() + 1;
        let first = parameters.len() + 1;
        let mut rest = text;
        while !rest.is_empty() {
            // Texts may be cut, numbers not; a comma is near.
            let end =
                if rest.len() <= 64 { rest.len() } else { rest[..64].rfind(',').map_or(64, |at| at + 1) };
            parameters.push(format!("{:64}{number:>8}P{:>7}", &rest[..end], parameters.len() + 1));
            rest = &rest[end..];
        }
        let count = parameters.len() + 1 - first;
        directory
            .push(format!("{kind:>8}{first:>8}{0:>8}{0:>8}{0:>8}{0:>8}{0:>8}{0:>8}{0:>8}D{number:>7}", 0));
        directory.push(format!("{kind:>8}{0:>8}{0:>8}{count:>8}{form:>8}{1:>32}D{2:>7}", 0, "", number + 1));
        number
    };
    let mut surface = 1;
    for (label, patches) in sets {
        for patch in patches {
            let [p, q] = patch.degrees;
            let (n_u, n_v) = (patch.rows.len(), patch.rows[0].len());
            let knots = |degree: usize, points: usize| {
                let pieces = (points - 1) / degree;
                let inner = (0..=pieces).flat_map(|k| std::iter::repeat_n(k, degree));
                let all = [0].into_iter().chain(inner).chain([pieces + 1]);
                all.map(|k| format!("{k}.0,")).collect::<String>()
            };
            let mut text =
                format!("128,{},{},{p},{q},0,0,1,0,0,{}{}", n_u - 1, n_v - 1, knots(p, n_u), knots(q, n_v));
            text += &"1.0,".repeat(n_u * n_v);
            for j in 0..n_v {
                for row in &patch.rows {
                    let [x, y, z] = row[j];
                    let _ = write!(text, "{x:?},{y:?},{z:?},");
                }
            }
            let _ =
                write!(text, "0.0,{}.0,0.0,{}.0,0,1,{};", (n_u - 1) / p + 1, (n_v - 1) / q + 1, surface + 2);
            add(128, 0, &text);
            let name = format!("Surf_{label}, {surface}");
            add(406, 15, &format!("406,1,{}H{name};", name.len()));
            surface += 4;
        }
    }
    let global = format!(",,4Hnone,5Ha.igs,7HOpenVSP,,32,38,6,308,15,,1.0,{unit},1,1.0;");
    let mut text = format!("{:72}S      1\n", "");
    for (k, part) in global.as_bytes().chunks(72).enumerate() {
        let _ = writeln!(text, "{:72}G{:>7}", String::from_utf8_lossy(part), k + 1);
    }
    text + &directory.join("\n") + "\n" + &parameters.join("\n") + "\n" + &format!("{:72}T      1\n", "")
}

/// Multiplicities and knots.
fn knots(degree: usize, points: usize) -> (String, String) {
    let pieces = (points - 1) / degree;
    let end = |k: usize| k == 0 || k == pieces;
    let list = |items: Vec<String>| format!("({})", items.join(","));
    let multiplicities = (0..=pieces).map(|k| (degree + usize::from(end(k))).to_string()).collect();
    (list(multiplicities), list((0..=pieces).map(|k| format!("{k}.")).collect()))
}

/// A point of a patch at `u`, `v`, by de Casteljau.
pub fn position(patch: &Bezier, u: f64, v: f64) -> [f64; 3] {
    let [p, q] = patch.degrees;
    let along = |points: &[[f64; 3]], degree: usize, t: f64| {
        let pieces = (points.len() - 1) / degree;
        let piece = (t.floor() as usize).min(pieces - 1);
        let s = t - piece as f64;
        let mut points = points[piece * degree..=(piece + 1) * degree].to_vec();
        while points.len() > 1 {
            points =
                points.windows(2).map(|w| [0, 1, 2].map(|k| (1.0 - s) * w[0][k] + s * w[1][k])).collect();
        }
        points[0]
    };
    let column: Vec<[f64; 3]> = patch.rows.iter().map(|row| along(row, q, v)).collect();
    along(&column, p, u)
}

/// A smooth curve through `f` at the parameters `ts`, as Bezier pieces that are C1 in `ts` and C0 in form.
pub fn chain(ts: &[f64], f: impl Fn(f64) -> [f64; 3]) -> Vec<[f64; 3]> {
    let slope = |t: f64| {
        let h = 1e-4;
        let (a, b) = (f(t - h), f(t + h));
        [0, 1, 2].map(|k| (b[k] - a[k]) / (2.0 * h))
    };
    let mut points = vec![f(ts[0])];
    for w in ts.windows(2) {
        let third = (w[1] - w[0]) / 3.0;
        let (a, b, da, db) = (f(w[0]), f(w[1]), slope(w[0]), slope(w[1]));
        points.push([0, 1, 2].map(|k| a[k] + third * da[k]));
        points.push([0, 1, 2].map(|k| b[k] - third * db[k]));
        points.push(b);
    }
    points
}

/// The half of a wing from y = 0 to `span`, on one side: skin of two sections (upper and lower each), caps at root and tip.
pub fn half_wing(chord: f64, span: f64, thickness: f64, side: f64) -> Vec<Bezier> {
    let ts = [0.0, 0.07, 0.21, 0.5, 0.77, 1.0];
    let section = |y: f64, upper: f64| {
        let c = chord * (1.0 - 0.4 * y / span);
        // Sharp at the trailing edge, round at the leading one: x = c s^2.
        chain(&ts, |s| [c * s * s + 0.2 * y, side * y, upper * thickness * c * s * (1.0 - s * s)])
    };
    let camber = |y: f64| -> Vec<[f64; 3]> { section(y, 1.0).iter().map(|p| [p[0], p[1], 0.0]).collect() };
    let ruled = |a, b| Bezier { degrees: [1, 3], rows: vec![a, b] };
    let mut patches = Vec::new();
    for (from, to) in [(0.0, 0.4 * span), (0.4 * span, span)] {
        for upper in [1.0, -1.0] {
            patches.push(ruled(section(from, upper), section(to, upper)));
        }
    }
    for y in [0.0, span] {
        for upper in [1.0, -1.0] {
            patches.push(ruled(section(y, upper), camber(y)));
        }
    }
    patches
}

/// A body of revolution along x in four quadrants, with a pole at each end.
pub fn body(length: f64, radius: f64) -> Vec<Bezier> {
    const ARC: f64 = 0.552_284_749_830_793_4;
    let ts = [0.0, 0.1, 0.35, 0.8, 1.0];
    (0..4)
        .map(|quadrant| {
            let (s, c) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][quadrant];
            let rows = [[1.0, 0.0], [1.0, ARC], [ARC, 1.0], [0.0, 1.0]];
            let rows = rows.map(|[a, b]| {
                let (y, z) = (a * c - b * s, a * s + b * c);
                chain(&ts, |t| {
                    let r = radius * 4.0 * t * (1.0 - t);
                    [length * t, r * y, r * z]
                })
            });
            Bezier { degrees: [3, 3], rows: rows.to_vec() }
        })
        .collect()
}

/// A disc, open.
pub fn disc(x: f64, radius: f64) -> Vec<Bezier> {
    vec![Bezier {
        degrees: [1, 1],
        rows: vec![
            vec![[x, 0.0, -radius], [x, 0.0, -radius]],
            vec![[x, radius, 0.0], [x, -radius, 0.0]],
            vec![[x, 0.0, radius], [x, 0.0, radius]],
        ],
    }]
}
