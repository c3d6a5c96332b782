//! Set-ups: uploads, descriptions, access, lists.

use moldline_host::{ServiceError, Tenant, TenantError};
use moldline_mesh::{Cell, LeftOut};
use moldline_mesh_service::{
    Access, ArchiveKind, Created, FileEntry, Listed, SetupSummary, StoredSetup, UploadHeader, UploadSource,
    Visibility,
};
use moldline_proto::v1::{self, DataType, create_setup_request::Part};

use super::{arrays, status};

/// The header of an upload, which must be its first message.
pub fn header(part: v1::CreateSetupRequest) -> Result<UploadHeader, ServiceError> {
    match part.part {
        Some(Part::Header(header)) => upload(header),
        _ => Err(ServiceError::invalid("header", "has to be the first message")),
    }
}

/// The header of an upload.
pub fn upload(header: v1::SetupHeader) -> Result<UploadHeader, ServiceError> {
    let v1::SetupHeader { request_id, setup_file, source, visibility, shared_with } = header;
    let visibility = self::visibility("header.", visibility, shared_with)?;
    let source = match source {
        Some(v1::setup_header::Source::Files(list)) => {
            let files = list.files.into_iter().map(|v1::FileEntry { path, size }| FileEntry { path, size });
            UploadSource::Files(files.collect())
        }
        Some(v1::setup_header::Source::Archive(archive)) => {
            let kind = match archive.kind() {
                v1::ArchiveKind::Tar => ArchiveKind::Tar,
                v1::ArchiveKind::TarGz => ArchiveKind::TarGz,
                v1::ArchiveKind::Zip => ArchiveKind::Zip,
                v1::ArchiveKind::Unspecified => {
                    return Err(ServiceError::invalid("header.archive.kind", "has to be tar, tar.gz or zip"));
                }
            };
            UploadSource::Archive { kind, size: archive.size }
        }
        None => return Err(ServiceError::invalid("header.source", "is missing: name files or an archive")),
    };
    let setup_file = (!setup_file.is_empty()).then_some(setup_file);
    Ok(UploadHeader { request_id, setup_file, visibility, source })
}

/// The visibility of a set-up, if it is specified. Errors name fields with `prefix` before them.
pub fn visibility(
    prefix: &str,
    visibility: i32,
    shared_with: Vec<String>,
) -> Result<Option<Visibility>, ServiceError> {
    let field = || format!("{prefix}visibility");
    let chosen = v1::Visibility::try_from(visibility)
        .map_err(|_| ServiceError::invalid(field(), format!("there is no visibility {visibility}")))?;
    const MOST: usize = 256;
    if shared_with.len() > MOST {
        let description = format!("{} tenants are more than {MOST}; make it public", shared_with.len());
        return Err(ServiceError::invalid(format!("{prefix}shared_with"), description));
    }
    if chosen != v1::Visibility::Tenants && !shared_with.is_empty() {
        let description = "names tenants, and so the visibility has to be VISIBILITY_TENANTS";
        return Err(ServiceError::invalid(format!("{prefix}shared_with"), description));
    }
    Ok(match chosen {
        v1::Visibility::Unspecified => None,
        v1::Visibility::Private => Some(Visibility::Private),
        v1::Visibility::Public => Some(Visibility::Public),
        v1::Visibility::Tenants => {
            let tenants = shared_with.iter().enumerate().map(|(index, name)| {
                let refuse = |error: TenantError| {
                    ServiceError::invalid(format!("{prefix}shared_with[{index}]"), error.to_string())
                };
                Tenant::new(name).map_err(refuse)
            });
            Some(Visibility::Tenants(tenants.collect::<Result<_, _>>()?))
        }
    })
}

/// A message of an upload after the first.
pub fn chunk(part: v1::CreateSetupRequest) -> Result<v1::SetupChunk, ServiceError> {
    match part.part {
        Some(Part::Chunk(chunk)) => Ok(chunk),
        _ => Err(ServiceError::invalid("chunk", "only chunks follow the header")),
    }
}

pub fn created(Created { setup, access, built }: &Created) -> v1::CreatedSetup {
    let setup_id = setup.id.to_string();
    v1::CreatedSetup { setup_id, built: *built, setup: Some(description(setup, access)) }
}

pub fn description(setup: &StoredSetup, access: &Access) -> v1::SetupDescription {
    let parameterisation = setup.engine.parameterisation();
    let variables = parameterisation.variables().iter().map(|variable| v1::Variable {
        name: variable.name.clone(),
        unit: variable.unit.symbol().to_owned(),
        baseline: variable.baseline,
        lower: variable.lower,
        upper: variable.upper,
    });
    let groups = parameterisation.groups().iter().map(|group| v1::VariableGroup {
        name: group.name.clone(),
        first: group.range.start as u32,
        shape: group.shape.iter().map(|&extent| extent as u32).collect(),
    });
    let functions = setup.engine.functions().iter().zip(&setup.functions).map(|(function, &value)| {
        v1::Function { name: function.name.clone(), unit: function.unit.to_owned(), value }
    });
    let components = setup.engine.components().iter();
    v1::SetupDescription {
        name: setup.name.clone(),
        report_json: setup.report_json(),
        report_text: setup.engine.report().to_string(),
        variables: variables.collect(),
        groups: groups.collect(),
        components: parameterisation.components().to_vec(),
        vertex_count: setup.engine.mesh().vertices.len() as u64,
        cell_count: setup.engine.mesh().cells.len() as u64,
        build_seconds: setup.build_time.as_secs_f64(),
        functions: functions.collect(),
        control_point_counts: components.map(|c| c.user_control_point_count() as u64).collect(),
        setup_id: setup.id.to_string(),
        access: Some(self::access(access)),
        turned_cell_count: setup.engine.report().turned_cells as u64,
        left_out: Some(left_out(setup.engine.report().left_out)),
    }
}

fn left_out(left_out: LeftOut) -> v1::LeftOut {
    let LeftOut { nodes, merged_nodes, other_cells, collapsed_cells } = left_out;
    v1::LeftOut {
        nodes: nodes as u64,
        merged_nodes: merged_nodes as u64,
        other_cells: other_cells as u64,
        collapsed_cells: collapsed_cells as u64,
    }
}

pub fn access(Access { owned, visibility }: &Access) -> v1::SetupAccess {
    let (visibility, shared_with) = match visibility {
        Visibility::Private => (v1::Visibility::Private, Vec::new()),
        Visibility::Public => (v1::Visibility::Public, Vec::new()),
        Visibility::Tenants(tenants) => {
            (v1::Visibility::Tenants, tenants.iter().filter(|_| *owned).map(Tenant::to_string).collect())
        }
    };
    v1::SetupAccess { owned: *owned, visibility: visibility.into(), shared_with }
}

pub fn listed_setups(Listed { entries, next }: Listed<SetupSummary>) -> v1::ListSetupsResponse {
    let setups = entries.into_iter().map(|entry| v1::SetupSummary {
        setup_id: entry.id,
        name: entry.name,
        vertex_count: entry.vertices as u64,
        cell_count: entry.cells as u64,
        variable_count: entry.variables as u64,
        created_time: status::unix_seconds(entry.created),
        access: Some(access(&entry.access)),
    });
    v1::ListSetupsResponse { setups: setups.collect(), next_page_token: next.unwrap_or_default() }
}

pub fn mesh(setup: &StoredSetup) -> v1::Mesh {
    let mesh = setup.engine.mesh();
    let mut seam = vec![0_u8; mesh.vertices.len()];
    for vertex in setup.engine.seam_vertices() {
        seam[vertex as usize] = 1;
    }
    let cells = mesh.cells.iter().flat_map(corners).flat_map(u32::to_le_bytes).collect();
    let owner: Vec<u8> = setup.engine.cell_owner().iter().flat_map(|owner| owner.to_le_bytes()).collect();
    v1::Mesh {
        vertices: Some(arrays::points(&mesh.vertices)),
        cells: Some(arrays::array(DataType::Uint32, &[mesh.cells.len(), 4], cells)),
        cell_owner: Some(arrays::array(DataType::Uint32, &[mesh.cells.len()], owner)),
        seam: Some(arrays::array(DataType::Uint8, &[seam.len()], seam)),
    }
}

/// Control points at the baseline.
pub fn control_points(setup: &StoredSetup) -> Result<Vec<v1::ControlPoints>, ServiceError> {
    let parameterisation = setup.engine.parameterisation();
    let points_of = parameterisation.control_points(&parameterisation.baseline())?;
    let components = parameterisation.components().iter().zip(&points_of);
    Ok(components
        .map(|(component, of)| v1::ControlPoints {
            component: component.clone(),
            points: Some(arrays::points(of)),
        })
        .collect())
}

/// Four vertices; the fourth of a triangle is the largest number.
fn corners(cell: &Cell) -> [u32; 4] {
    let mut corners = [u32::MAX; 4];
    corners[..cell.vertices().len()].copy_from_slice(cell.vertices());
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_are_marked_by_their_fourth_vertex() {
        assert_eq!(corners(&Cell::triangle(1, 2, 3)), [1, 2, 3, u32::MAX]);
        assert_eq!(corners(&Cell::quad(1, 2, 3, 4)), [1, 2, 3, 4]);
    }
}
