//! Limits on requests and on the memory of the service. All are checked before anything is allocated.

use moldline_host::Sharing;
use moldline_store::Quota;

/// Upper limits; the defaults suit a workstation.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Bytes of one upload.
    pub upload_bytes: u64,
    /// Files of one upload.
    pub upload_files: usize,
    /// Uploads at a time.
    pub uploads: usize,
    /// Working memory of requests under way, bytes: messages, uploads, builds, answers. Caches have their own.
    pub memory: u64,
    /// Whether tenants share places and memory, or one may take all.
    pub sharing: Sharing,
    /// Bytes of one chunk.
    pub chunk_bytes: usize,
    /// Bytes of a path.
    pub path_bytes: usize,
    /// Bytes of a request id.
    pub request_id_bytes: usize,
    /// Bytes that an archive may unpack to.
    pub unpacked_bytes: u64,
    /// Components, control points, vertices and cells of a set-up.
    pub setup_file: moldline_setup_files::Limits,
    /// Entries of one page of a list.
    pub page: usize,
    /// Set-ups of one tenant.
    pub setups: usize,
    /// Open sessions of one tenant.
    pub sessions: usize,
    /// Bytes of one tenant's set-ups in the store, and of its sessions beyond what is free.
    pub stored_bytes: u64,
    /// Tenants with which one set-up is shared by name.
    pub shared_with: usize,
    /// Whether a tenant's first upload of content that the server knows takes the time of its build, so that it does not tell
    /// what others have.
    pub hide_known: bool,
    /// Running and waiting tasks of one tenant.
    pub load: usize,
    /// Bytes of a label.
    pub label_bytes: usize,
    /// Bytes of the set-ups in memory.
    pub setup_bytes: usize,
    /// Bytes of the linearisations in memory.
    pub linearisation_bytes: usize,
    /// Directions or seeds of one request.
    pub vectors: usize,
    /// Bytes of the vertices in one request's directions or seeds, or in one block of results.
    pub vector_bytes: usize,
    /// Checks of derivatives at a time; each is minutes of work.
    pub checks: usize,
    /// Designs of one check.
    pub check_designs: usize,
}

impl Default for Limits {
    fn default() -> Self {
        const MIB: u64 = 1 << 20;
        Self {
            upload_bytes: 256 * MIB,
            upload_files: 1000,
            uploads: 16,
            memory: 4 << 30,
            sharing: Sharing::Fair,
            chunk_bytes: 1 << 20,
            path_bytes: 1024,
            request_id_bytes: 128,
            unpacked_bytes: 512 * MIB,
            setup_file: moldline_setup_files::Limits {
                // One response carries all vertices: 2.7 million of them are 64 MiB.
                mesh: moldline_mesh::Limits { vertices: 2_000_000, cells: 2_000_000, ..Default::default() },
                ..Default::default()
            },
            page: 1000,
            setups: 1000,
            sessions: 1000,
            stored_bytes: 64 << 30,
            shared_with: 256,
            hide_known: true,
            load: 64,
            label_bytes: 256,
            setup_bytes: 4 << 30,
            linearisation_bytes: 2 << 30,
            vectors: 64,
            vector_bytes: 128 << 20,
            checks: 1,
            check_designs: 16,
        }
    }
}

impl Limits {
    /// What a tenant may hold in the store, if it has no quota of its own.
    pub fn quota(&self) -> Quota {
        Quota { setups: self.setups, sessions: self.sessions, bytes: self.stored_bytes }
    }
}
