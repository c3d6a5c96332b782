//! Free-form deformation (paper II.A, eqs. 3 and 4) with a lattice organised by spanwise sections.
//!
//! The map is three in a row: the design gives the quantities of every section (linear), these move the lattice
//! (the only step that is not linear), and each target takes the lattice's displacement by its B-spline weights
//! (linear). A target moves by F(xi; B*) - F(xi; B0), so the baseline is reproduced exactly.

mod declaration;
mod embedding;
mod lattice;
mod quantities;

use moldline_foundation::Vector3;

use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::operation::{Declaration, Lattice, Operation};
use crate::reference::ComponentReference;
use crate::scalar::Scalar;
use crate::sections::SampledSurfaces;
use embedding::Embedding;
use lattice::{SectionLattice, Sections};
use quantities::Quantities;

pub use declaration::{FreeFormDeclaration, SectionDeclaration, SectionKind};

/// Lattice points, and weights of embedded points, that a block may have.
const LATTICE_LIMIT: usize = 200_000;
const WEIGHT_LIMIT: usize = 50_000_000;

impl FreeFormDeclaration {
    /// Refuses more lattice points, or more weights of `targets`, than a block may have.
    fn check_size(&self, site: &Site, targets: usize) -> Result<(), ParameterisationError> {
        let mut shape = self.shape.iter();
        let lattice = shape.try_fold(1, |product: usize, &n| product.checked_mul(n)).unwrap_or(usize::MAX);
        limit(site.field("shape (product)"), lattice, LATTICE_LIMIT)?;
        let per_target: usize = self.degree.iter().map(|&p| p.min(LATTICE_LIMIT) + 1).product();
        limit(site.field("degree (weights)"), per_target.saturating_mul(targets), WEIGHT_LIMIT)
    }
}

impl Declaration for FreeFormDeclaration {
    type Compiled = FreeForm;

    fn components(&self) -> &[String] {
        &self.components
    }

    fn compile(&self, site: &Site, compiler: &mut Compiler<'_>) -> Result<FreeForm, ParameterisationError> {
        if self.sections.is_empty() {
            return Err(ParameterisationError::Empty { field: site.field("sections") });
        }
        let embedded: Vec<&ComponentReference> =
            site.members.iter().map(|&c| &compiler.components[c]).collect();
        let surfaces = SampledSurfaces::new(&embedded);
        let targets = compiler.targets(site);
        self.check_size(site, targets.len())?;
        // The control points span the lattice; points carried along take the displacement of the closest place in it.
        let embedded: usize = site.members.iter().map(|&c| compiler.ranges[c].len()).sum();
        let points: Vec<Vector3> = targets.iter().map(|&i| compiler.points[i]).collect();

        let volume = lattice::volume(site, self)?;
        let sections = Sections::cut(site, self, &volume.knots()[1], &surfaces, &points[..embedded])?;
        let places: Vec<_> = points.iter().map(|point| sections.locate(point, &volume.knots()[1])).collect();
        let lattice = SectionLattice::new(volume, sections, &places[..embedded]);
        let quantities = Quantities::new(site, self, &lattice, &mut compiler.variables)?;
        let embedding = Embedding::new(&lattice, targets, &points, &places);
        Ok(FreeForm { quantities, lattice, embedding })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct FreeForm {
    quantities: Quantities,
    lattice: SectionLattice,
    embedding: Embedding,
}

impl Operation for FreeForm {
    fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let step = self.lattice.displacement(&self.quantities.eval(design));
        self.embedding.eval(&step, points);
    }

    fn jvp(&self, design: &[f64], _: &[Vector3], direction: &[f64], tangents: &mut [Vector3]) {
        let change = self.quantities.jvp(direction);
        let step = self.lattice.jvp(&self.quantities.eval(design), &change);
        self.embedding.jvp(&step, tangents);
    }

    fn vjp(&self, design: &[f64], _: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]) {
        let on_lattice = self.embedding.vjp(self.lattice.len(), seeds);
        let on_quantities = self.lattice.vjp(&self.quantities.eval(design), &on_lattice);
        self.quantities.vjp(&on_quantities, gradient);
    }

    fn lattice(&self, design: &[f64]) -> Option<Lattice> {
        let steps = self.lattice.displacement(&self.quantities.eval(design));
        let points = self.lattice.reference().into_iter().zip(steps);
        Some(Lattice {
            shape: self.lattice.shape(),
            points: points.map(|(p, step)| (p + step).into()).collect(),
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
