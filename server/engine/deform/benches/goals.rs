//! The numbers that Moldline promises, measured on the E175: `cargo xtask bench` runs this and compares.
//!
//! One JSON object a line goes to standard output: name, value, unit, goal. An argument, `interpolation` or `engine`, is the part to
//! run; without it both are. The data of the interpolation goes to the folder named by `MOLDLINE_BENCH_DATA`, for scipy to
//! do the same. `MOLDLINE_BENCH_LARGE` names the folder of a finer mesh.

use std::{
    env, fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use moldline_deform::{Kernel, NoMonitor, OuterMoldLine, Setup, SetupInput, Tangent};
use moldline_geometry::{Block, Body, Location};
use moldline_rbf::RadialBasis;
use moldline_setup_files::{Files, Limits, read_folder, read_setup};
use moldline_spline::Vector3;
use serde_json::{Value, json};

type Failure = Box<dyn std::error::Error>;

/// The set-up measured.
const SETUP_FILE: &str = "setup-motions.toml";
/// Points of the closest-point benchmark, and of the interpolation.
const POINTS: usize = 15_000;
const CENTRES: usize = 1_500;
/// Designs that are timed: the corners of Fig. 6.
const CORNERS: [(f64, f64); 4] = [(5.0, 10.0), (5.0, -10.0), (-5.0, -10.0), (-5.0, 10.0)];

fn main() -> Result<(), Failure> {
    let e175 = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../examples/e175");
    let files = read_folder(&e175.join(SETUP_FILE), &Limits::default())?.0;
    let part = env::args().skip(1).find(|argument| !argument.starts_with('-'));
    let wanted = |name: &str| part.as_deref().is_none_or(|part| part == name);
    if wanted("interpolation") {
        interpolation(&parse(&files)?)?;
    }
    if wanted("engine") {
        engine(&e175, &files)?;
    }
    Ok(())
}

fn engine(e175: &Path, files: &Files) -> Result<(), Failure> {
    let input = parse(files)?;
    closest_points(&input)?;

    let (setup, seconds) = median_of(3, || {
        let input = parse(files)?;
        Ok(Setup::build(input, &NoMonitor)?)
    })?;
    let training: usize = setup.report().fields.iter().map(|field| field.training_vertices).sum();
    tell("set-up, 15,000 cells", seconds, "s", "<= 5");
    tell("set-up, training vertices", training, "vertices", "about 1500");
    let sharp = deforming("15,000 cells, sharp", "<= 100", &setup)?;
    threads_do_not_matter("sharp", &setup)?;
    let cells = setup.mesh().cells.len() as f64;

    let smooth = Setup::build(smoothed(input), &NoMonitor)?;
    deforming("15,000 cells, smooth", "<= 100", &smooth)?;
    threads_do_not_matter("smooth", &smooth)?;

    // With the 45 variables of Table 2.
    let table2 = read_setup(&read_folder(e175, &Limits::default())?.0, None, &Limits::default())?.input;
    for (name, input) in [("sharp", table2.clone()), ("smooth", smoothed(table2))] {
        differentiating(name, &Arc::new(Setup::build(input, &NoMonitor)?))?;
    }

    if let Some(folder) = env::var_os("MOLDLINE_BENCH_LARGE") {
        // The fine mesh and its geometry with the example's set-up file.
        let folder = PathBuf::from(folder);
        let read = |name: &String| fs::read(folder.join(name)).map(|bytes| (name.clone(), bytes));
        let names = files.keys().filter(|name| *name != SETUP_FILE);
        let mut fine: Files = names.map(read).collect::<Result<_, _>>()?;
        fine.insert(SETUP_FILE.to_owned(), files[SETUP_FILE].clone());
        let (setup, seconds) = median_of(1, || Ok(Setup::build(parse(&fine)?, &NoMonitor)?))?;
        tell("set-up, 100,000 cells", seconds, "s", "measured");
        let milliseconds = deforming("100,000 cells, sharp", "<= 1000", &setup)?;
        let growth = (milliseconds / sharp).ln() / (setup.mesh().cells.len() as f64 / cells).ln();
        tell("Deform, time grows as cells to the power", growth, "1", "measured");
        let smooth = Setup::build(smoothed(parse(&fine)?), &NoMonitor)?;
        deforming("100,000 cells, smooth", "<= 1000", &smooth)?;
    }
    Ok(())
}

fn parse(files: &Files) -> Result<SetupInput, Failure> {
    Ok(read_setup(files, Some(SETUP_FILE), &Limits::default())?.input)
}

fn smoothed(mut input: SetupInput) -> SetupInput {
    input.options.outer_mold_line = OuterMoldLine::Smooth;
    input
}

fn tell(name: &str, value: impl Into<Value>, unit: &str, goal: &str) {
    println!("{}", json!({ "name": name, "value": value.into(), "unit": unit, "goal": goal }));
}

/// Products with the derivative half way to the upper bounds, in terms of the time of a deformation there.
fn differentiating(name: &str, setup: &Arc<Setup>) -> Result<(), Failure> {
    let variables = setup.parameterisation().variables().iter();
    let design: Vec<f64> = variables.map(|v| v.baseline + 0.5 * (v.upper - v.baseline)).collect();
    let (_, deform) = median_of(9, || Ok(setup.deform(&design, &NoMonitor)?))?;
    tell(&format!("Deform, 45 variables, {name}"), 1e3 * deform, "ms", "<= 100");
    let (linearisation, linearise) = median_of(9, || Ok(setup.linearise(&design, &NoMonitor)?))?;
    tell(&format!("Deform with its linearisation, {name}"), linearise / deform, "x Deform", "measured");
    let megabytes = linearisation.bytes() as f64 / 1e6;
    tell(&format!("linearisation, {name}, memory"), megabytes, "MB", "<= 60");
    let mut random = Random(9);
    let mut seed = || Tangent {
        vertices: setup.mesh().vertices.iter().map(|_| random.vector().into()).collect(),
        functions: vec![1.0; setup.functions().len()],
    };
    let seeds: Vec<Tangent> = (0..6).map(|_| seed()).collect();
    for (count, goal) in [(1, "<= 1"), (6, "<= 2")] {
        let (_, seconds) = median_of(9, || Ok(linearisation.vjp(&seeds[..count])?))?;
        let plural = if count == 1 { "" } else { "s" };
        tell(&format!("VJP, {count} seed{plural}, {name}"), seconds / deform, "x Deform", goal);
    }
    let unit = |i: usize| (0..design.len()).map(|j| f64::from(i == j)).collect();
    let directions: Vec<Vec<f64>> = (0..design.len()).map(unit).collect();
    let (_, seconds) = median_of(5, || Ok(linearisation.jvp(&directions)?))?;
    tell(&format!("JVP, {} directions, {name}", design.len()), seconds / deform, "x Deform", "<= 3");
    Ok(())
}

/// The last result, and the median of the seconds.
fn median_of<T>(times: usize, mut work: impl FnMut() -> Result<T, Failure>) -> Result<(T, f64), Failure> {
    let mut seconds = Vec::new();
    loop {
        let start = Instant::now();
        let result = work()?;
        seconds.push(start.elapsed().as_secs_f64());
        if seconds.len() >= times {
            seconds.sort_by(f64::total_cmp);
            return Ok((result, seconds[seconds.len() / 2]));
        }
    }
}

/// Seconds that this thread has been on a processor; wall clock where the system does not say.
fn cpu_seconds(epoch: Instant) -> f64 {
    let statistics = fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = statistics.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| epoch.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

/// Milliseconds of a deformation: median over the corners of Fig. 6, three times each.
fn deforming(name: &str, goal: &str, setup: &Setup) -> Result<f64, Failure> {
    let mut seconds = Vec::new();
    for _ in 0..3 {
        for corner in CORNERS {
            let design = design(setup, corner)?;
            let start = Instant::now();
            setup.deform(&design, &NoMonitor)?;
            seconds.push(start.elapsed().as_secs_f64());
        }
    }
    seconds.sort_by(f64::total_cmp);
    let median = 1e3 * seconds[seconds.len() / 2];
    tell(&format!("Deform, engine, {name}, {} threads", rayon::current_num_threads()), median, "ms", goal);
    Ok(median)
}

fn design(setup: &Setup, (translation, rotation): (f64, f64)) -> Result<Vec<f64>, Failure> {
    let values =
        [("wing.translation", translation), ("wing.rotation", rotation), ("htail.rotation", rotation)];
    Ok(setup.parameterisation().design(values)?)
}

fn threads_do_not_matter(name: &str, setup: &Setup) -> Result<(), Failure> {
    let design = design(setup, CORNERS[0])?;
    let mut bits: Vec<Vec<u64>> = Vec::new();
    for threads in [1, 2, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let vertices = pool.install(|| setup.deform(&design, &NoMonitor))?.vertices;
        bits.push(vertices.iter().flatten().map(|x| x.to_bits()).collect());
    }
    let same = bits.iter().all(|other| *other == bits[0]);
    tell(&format!("Deform, {name}: identical bytes twice, and with 1 and 2 threads"), same, "", "true");
    Ok(())
}

/// A linear congruential generator (Knuth, MMIX), so that everyone measures the same points.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn vector(&mut self) -> Vector3 {
        Vector3::from_fn(|_, _| 2.0 * self.unit() - 1.0)
    }
}

/// Half of the points within centimetres of the E175's wing, half anywhere around it.
fn closest_points(input: &SetupInput) -> Result<(), Failure> {
    let index = input.components.iter().position(|c| c.name() == "wing").ok_or("the E175 has no wing")?;
    let component = Arc::new(input.components[index].clone());
    let parameterisation = &input.parameterisation;
    let control_points = parameterisation.control_points(&parameterisation.baseline())?;
    let internal = component.internal_control_points(&control_points[index]);
    let wing = Body::new(Arc::clone(&component), internal.clone());

    // The reference: many samples of every patch; none may be nearer, nor what Newton finds from the nearest ones.
    const GRID: usize = 60;
    let mut samples = Vec::new();
    for (patch, description) in (0u32..).zip(component.patches()) {
        let [(u0, u1), (v0, v1)] = description.surface.domain();
        for i in 0..=GRID {
            for j in 0..=GRID {
                let at = |low: f64, high: f64, k: usize| low + (high - low) * k as f64 / GRID as f64;
                let location = Location { patch, u: at(u0, u1, i), v: at(v0, v1, j) };
                samples.push((wing.position(&location), location));
            }
        }
    }
    let bounds = wing.bounds();
    let (centre, half) = (0.5 * (bounds.low + bounds.high), 0.5 * (bounds.high - bounds.low));
    let mut random = Random(175);
    let points: Vec<Vector3> = (0..POINTS)
        .map(|k| {
            if k % 2 == 0 {
                let (on, _) = samples[(random.unit() * samples.len() as f64) as usize];
                on + 0.05 * random.vector()
            } else {
                centre + random.vector().component_mul(&half.add_scalar(5.0))
            }
        })
        .collect();

    let epoch = Instant::now();
    let start = cpu_seconds(epoch);
    // A new body, so that the building of its hierarchy is in the time.
    let fresh = Body::new(Arc::clone(&component), internal);
    let found: Vec<f64> = points.iter().map(|x| fresh.closest_point(x).distance.abs()).collect();
    tell("closest point, 15,000 points near and far, CPU", cpu_seconds(epoch) - start, "s", "<= 0.3");

    let mut wrong = 0;
    for (x, &distance) in points.iter().zip(&found) {
        let mut nearest: Vec<(f64, &Location)> =
            samples.iter().map(|(position, location)| ((position - x).norm_squared(), location)).collect();
        nearest.select_nth_unstable_by(8, |a, b| a.0.total_cmp(&b.0));
        let refined = nearest[..8]
            .iter()
            .map(|(squared, location)| {
                let foot = wing.closest_point_near(x, location);
                foot.map_or(squared.sqrt(), |foot| foot.distance.abs().min(squared.sqrt()))
            })
            .fold(f64::INFINITY, f64::min);
        wrong += usize::from(refined < distance - 1e-9);
    }
    tell("closest point, wrong against samples refined exhaustively", wrong, "points", "0");
    Ok(())
}

/// Cubic interpolation of three columns over vertices of the mesh.
fn interpolation(input: &SetupInput) -> Result<(), Failure> {
    let vertices: Vec<Vector3> = input.mesh.vertices.iter().map(|x| Vector3::from(*x)).collect();
    let mut random = Random(8);
    // Distinct vertices, evenly spread over their numbers; points are vertices too, moved a little.
    let centres: Vec<Vector3> = (0..CENTRES).map(|k| vertices[k * vertices.len() / CENTRES]).collect();
    let points: Vec<Vector3> =
        (0..POINTS).map(|k| vertices[k % vertices.len()] + 0.02 * random.vector()).collect();
    let data: Vec<Vector3> = centres
        .iter()
        .map(|c| Vector3::new((0.2 * c.x).sin(), (0.3 * c.y).cos() * c.z, 0.01 * c.x * c.y))
        .collect();

    let start = Instant::now();
    let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0)?;
    tell("cubic RBF, 1,500 centres, factorise", 1e3 * start.elapsed().as_secs_f64(), "ms", "measured");
    let mut block = Block::zeros(CENTRES, 3);
    data.iter().enumerate().for_each(|(i, d)| block.row_mut(i).copy_from_slice(d.as_slice()));
    let mut out = Block::zeros(POINTS, 3);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let ((), both) = median_of(9, || {
            out = pool.install(|| basis.evaluate(&basis.fit(&block), &points));
            Ok(())
        })?;
        let name =
            format!("cubic RBF, 1,500 centres to 15,000 points, solve and evaluate, {threads} threads");
        tell(&name, 1e3 * both, "ms", "measured");
    }

    if let Some(folder) = env::var_os("MOLDLINE_BENCH_DATA") {
        let folder = PathBuf::from(folder);
        fs::create_dir_all(&folder)?;
        let values: Vec<Vector3> = (0..POINTS).map(|i| out.vector(i, 0)).collect();
        for (name, values) in
            [("centres", &centres), ("points", &points), ("data", &data), ("values", &values)]
        {
            let bytes: Vec<u8> = values.iter().flat_map(|x| x.iter()).flat_map(|x| x.to_le_bytes()).collect();
            fs::write(folder.join(format!("{name}.f64")), bytes)?;
        }
    }
    Ok(())
}
