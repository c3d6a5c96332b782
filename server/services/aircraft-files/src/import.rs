//! The import as a whole.

use std::{borrow::Cow, collections::BTreeMap};

use moldline_foundation::monitor::Monitor;
use moldline_geometry::Component;
use moldline_setup_files::Files;

use crate::{
    assembly::{Assembled, LeftOut, assemble},
    error::ImportError,
    iges,
    limits::ImportLimits,
    measure::{Samples, area_and_volume},
    model::{Model, SurfaceSet},
    report::{ComponentReport, ImportReport, LeftOutReport},
    shape::{Shape, shape},
    step, write,
};

/// Options of an import.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportOptions {
    /// Title of the set-up.
    pub title: String,
    /// Metres per unit of the file, instead of what the file says.
    pub metres_per_unit: Option<f64>,
    /// Names or IDs of the components to import; all if empty.
    pub only: Vec<String>,
    /// Names or IDs of components to leave out.
    pub skip: Vec<String>,
    /// Limits on the file.
    pub limits: ImportLimits,
}

/// A stage of an import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImportStage {
    /// Reading the file.
    Reading,
    /// Making closed components.
    Assembly,
    /// Writing the set-up.
    Writing,
}

/// An imported aircraft.
#[derive(Debug, Clone)]
pub struct Import {
    /// `setup.toml` and the geometry files that it names. The set-up wants a mesh, `mesh.msh`.
    pub files: Files,
    /// What was found.
    pub report: ImportReport,
}

/// Imports a STEP or IGES file; its first bytes tell which.
///
/// # Errors
/// What is wrong with the file, where, and the way out.
pub fn import(
    bytes: &[u8],
    options: &ImportOptions,
    monitor: &dyn Monitor<ImportStage>,
) -> Result<Import, ImportError> {
    monitor.progress(ImportStage::Reading, 0.0);
    let Model { unit: file_unit, sets } = read(bytes, &options.limits)?;
    if sets.is_empty() {
        return Err(ImportError::NoSurfaces { hint: String::new() });
    }
    let metres_per_unit = options.metres_per_unit.or(file_unit.as_ref().map(|u| u.metres)).unwrap_or(1.0);
    let groups = chosen(named(sets), options)?;

    let count = groups.len();
    let mut components: Vec<Assembled> = Vec::new();
    let mut left_out: Vec<LeftOut> = Vec::new();
    for (index, mut sets) in groups.into_iter().enumerate() {
        monitor.progress(ImportStage::Assembly, index as f64 / count as f64);
        if monitor.cancelled() {
            return Err(ImportError::Cancelled);
        }
        scale(&mut sets, metres_per_unit);
        let (component, open) = assemble(sets);
        components.extend(component);
        left_out.extend(open);
    }
    if components.is_empty() {
        let reasons: Vec<String> =
            left_out.iter().take(5).map(|l| format!("{} is {}", l.name, l.reason)).collect();
        return Err(ImportError::NothingClosed { reasons: reasons.join("; ") });
    }

    let mut written = Vec::with_capacity(components.len());
    let mut reports = Vec::with_capacity(components.len());
    for (index, component) in components.into_iter().enumerate() {
        monitor.progress(ImportStage::Writing, index as f64 / count as f64);
        if monitor.cancelled() {
            return Err(ImportError::Cancelled);
        }
        let samples = Samples::new(&component.body);
        let shape = shape(&samples);
        let block = write::parameterisation(&component, &shape, &samples);
        reports.push(report(&component, &shape, block.variables));
        written.push((component, block));
    }
    let low = [0, 1, 2].map(|k| reports.iter().map(|r| r.low[k]).fold(f64::INFINITY, f64::min));
    let high = [0, 1, 2].map(|k| reports.iter().map(|r| r.high[k]).fold(f64::NEG_INFINITY, f64::max));
    let left_out = left_out.into_iter();
    let left_out = left_out
        .map(|LeftOut { id, name, patches, reason }| LeftOutReport { name, id, patches, reason })
        .collect();
    Ok(Import {
        files: write::files(&options.title, &written),
        report: ImportReport { file_unit, metres_per_unit, low, high, components: reports, left_out },
    })
}

fn read(bytes: &[u8], limits: &ImportLimits) -> Result<Model, ImportError> {
    if bytes.len() > limits.bytes {
        return Err(ImportError::Limit { what: "bytes", found: bytes.len(), limit: limits.bytes });
    }
    // Labels in other encodings than UTF-8 are the only text that is not ASCII.
    let text = String::from_utf8_lossy(bytes);
    let start = text.trim_start_matches('\u{feff}').trim_start();
    if start.starts_with("ISO-10303-21") || start.starts_with("/*") {
        return step::read(start, limits);
    }
    // Columns of IGES are bytes.
    let ascii =
        |text: Cow<'_, str>| -> String { text.chars().map(|c| if c.is_ascii() { c } else { '?' }).collect() };
    let text = if text.is_ascii() { text } else { Cow::Owned(ascii(text)) };
    match text.as_bytes().get(72) {
        Some(b'S' | b'G') => iges::read(&text, limits),
        _ => Err(ImportError::Format),
    }
}

/// Sets by ID, with unique names that can be names of files and variables.
fn named(sets: Vec<SurfaceSet>) -> Vec<Vec<SurfaceSet>> {
    let mut order: Vec<Vec<SurfaceSet>> = Vec::new();
    let mut index: BTreeMap<String, usize> = BTreeMap::new();
    for set in sets {
        let at = *index.entry(set.id.clone()).or_insert_with(|| {
            order.push(Vec::new());
            order.len() - 1
        });
        order[at].push(set);
    }
    let mut used: BTreeMap<String, usize> = BTreeMap::new();
    for group in &mut order {
        let plain: String = group[0]
            .name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' })
            .collect();
        let plain: String = plain.chars().take(64).collect();
        let plain = if plain.is_empty() { "component".to_owned() } else { plain };
        let mut name = plain.clone();
        // On some systems the case of a file name does not count.
        while used.contains_key(&name.to_ascii_lowercase()) {
            let number = used.entry(plain.to_ascii_lowercase()).or_insert(1);
            *number += 1;
            name = format!("{plain}_{number}");
        }
        used.insert(name.to_ascii_lowercase(), 1);
        group.iter_mut().for_each(|set| set.name = name.clone());
    }
    order
}

/// The groups that the options ask for.
fn chosen(
    groups: Vec<Vec<SurfaceSet>>,
    options: &ImportOptions,
) -> Result<Vec<Vec<SurfaceSet>>, ImportError> {
    let is = |group: &[SurfaceSet], name: &String| group[0].name == *name || group[0].id == *name;
    for (option, names) in [("--only", &options.only), ("--skip", &options.skip)] {
        if let Some(name) = names.iter().find(|name| !groups.iter().any(|group| is(group, name))) {
            let known: Vec<String> = groups.iter().map(|g| format!("{} ({})", g[0].name, g[0].id)).collect();
            return Err(ImportError::Unknown { option, name: name.clone(), known: known.join(", ") });
        }
    }
    let wanted = |group: &Vec<SurfaceSet>| {
        let any = |names: &[String]| names.iter().any(|name| is(group, name));
        (options.only.is_empty() || any(&options.only)) && !any(&options.skip)
    };
    Ok(groups.into_iter().filter(wanted).collect())
}

fn scale(sets: &mut [SurfaceSet], metres_per_unit: f64) {
    if metres_per_unit != 1.0 {
        let points =
            sets.iter_mut().flat_map(|set| &mut set.patches).flat_map(|patch| &mut patch.control_points);
        points.flatten().for_each(|x| *x *= metres_per_unit);
    }
}

fn report(component: &Assembled, shape: &Shape, variables: usize) -> ComponentReport {
    let (area, volume) = area_and_volume(&component.body);
    let samples = Samples::new(&component.body);
    let joined = component.body.component();
    ComponentReport {
        name: component.name.clone(),
        id: component.id.clone(),
        shape: match shape {
            Shape::Wing(_) => "wing",
            Shape::Body(_) => "body",
            Shape::Other => "other",
        },
        sets: component.sets,
        shells: shells(joined),
        patches_in_file: component.patches_before,
        patches: component.patches.len(),
        pieces_in_file: component.pieces_before,
        pieces: joined.patches().len(),
        knots_removed: component.knots_removed,
        removal_change: component.removal_change,
        weld: component.weld,
        edge_tolerance: component.edge_tolerance,
        area,
        volume,
        low: samples.low.into(),
        high: samples.high.into(),
        variables,
    }
}

/// Number of sets of patches that hang together by edges.
fn shells(component: &Component) -> usize {
    let count = component.patches().len();
    let mut root: Vec<usize> = (0..count).collect();
    let find = |root: &[usize], mut i: usize| {
        while root[i] != i {
            i = root[i];
        }
        i
    };
    for edge in component.edges() {
        if let [a, b] = edge.sides[..] {
            let (a, b) = (find(&root, a.patch as usize), find(&root, b.patch as usize));
            root[a.max(b)] = a.min(b);
        }
    }
    (0..count).filter(|&i| root[i] == i).count()
}
