"""Meshes the union of closed B-spline components with gmsh's OpenCASCADE kernel, and moves every vertex exactly onto its
surfaces.

The configurations beside this file use it; the B-splines are those of examples/e175. gmsh's vertices lie within its CAD
tolerance of the surfaces; afterwards each is moved onto all patches that meet in it, so that seam vertices lie on both
components, triple points on three, and vertices of sharp edges on both sides of the edge, to rounding.
"""

from __future__ import annotations

import sys
from pathlib import Path

import gmsh
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "e175"))

import quality
from bspline import POLE_TOLERANCE, Component, Patch
from cad import occ_surface
from mesh import Mesh

FAR = 1e3  # m, larger than any configuration
CAD_TOLERANCE = 1e-5  # m, how far gmsh's vertices may be off the surfaces


def split_at_creases(patch: Patch):
    """The pieces of a patch between interior knots of multiplicity >= degree, where it is only C0; exact."""
    pieces = [patch]
    for axis in (0, 1):
        pieces = [part for piece in pieces for part in _split_axis(piece, axis)]
    return pieces


def _split_axis(patch, axis):
    degree = (patch.degree_u, patch.degree_v)[axis]
    knots = (patch.knots_u, patch.knots_v)[axis]
    values, times = np.unique(knots[degree + 1 : -degree - 1], return_counts=True)
    first, first_knot = 0, 0
    parts = []
    for value in [*values[times >= degree], None]:
        if value is None:
            last, piece_knots = patch.control_points.shape[axis], knots[first_knot:]
        else:
            # the knot's control point is interpolated: it ends one piece and begins the next
            last = int(np.searchsorted(knots, value, side="right")) - degree
            piece_knots = np.append(knots[first_knot : last + degree], value)
        if first_knot:
            piece_knots = np.concatenate([[piece_knots[0]], piece_knots])
        rows = slice(first, last)
        index = (rows, slice(None)) if axis == 0 else (slice(None), rows)
        weights = None if patch.weights is None else np.asarray(patch.weights)[index]
        both = [patch.knots_u, patch.knots_v]
        both[axis] = piece_knots
        parts.append(Patch(patch.name, patch.degree_u, patch.degree_v, *both, patch.control_points[index], weights))
        first, first_knot = last - 1, last
    return parts


def poles(pieces):
    """The points that collapsed sides of patches stand for."""
    sides = [
        side
        for p in pieces
        for side in (p.control_points[0], p.control_points[-1], p.control_points[:, 0], p.control_points[:, -1])
    ]
    return np.array([side[0] for side in sides if np.ptp(side, axis=0).max() < POLE_TOLERANCE]).reshape(-1, 3)


def mesh_union(components: list[Component], size, quads: bool, half: bool) -> Mesh:
    """The union's surface; with `half` only y >= 0, open at y = 0.

    size: function of (x, y, z) giving the edge length wanted there.
    """
    pieces = [
        (owner, piece) for owner, c in enumerate(components) for patch in c.patches for piece in split_at_creases(patch)
    ]
    gmsh.initialize()
    try:
        for name, value in (
            ("General.Verbosity", 2),
            ("General.NumThreads", 1),
            ("Mesh.MeshSizeFromPoints", 0),
            ("Mesh.MeshSizeFromCurvature", 0),
            ("Mesh.MeshSizeExtendFromBoundary", 0),
            ("Mesh.Algorithm", 6),
            ("Mesh.RecombineAll", int(quads)),
            ("Mesh.Smoothing", 10),
        ):
            gmsh.option.setNumber(name, value)
        _union(pieces, len(components), half)
        gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, lc: size(x, y, z))
        gmsh.model.mesh.generate(2)
        vertices, cells, face = _take_mesh(half)
    finally:
        gmsh.finalize()

    # which piece each face lies on: the one its vertices are nearest to
    cell_piece = np.empty(len(cells), int)
    for tag in np.unique(face):
        on_face = np.unique(cells[face == tag])
        off = [piece.closest(vertices[on_face]).distance.max() for _, piece in pieces]
        if min(off) > CAD_TOLERANCE:
            raise RuntimeError(f"face {tag} lies on no patch: {min(off):.1e} m off the nearest")
        cell_piece[face == tag] = int(np.argmin(off))
    cells = _outward(vertices, cells, face, cell_piece, pieces)
    vertices = _onto_patches(vertices, cells, cell_piece, pieces, half)
    cells, cell_piece = _split_flat(vertices, cells, cell_piece)
    owner = np.array([piece_owner for piece_owner, _ in pieces])[cell_piece]
    return Mesh(vertices, cells, owner, [c.name for c in components])


def _union(pieces, count, half):
    """Leaves the union's outer faces in the gmsh model."""
    occ = gmsh.model.occ
    solids = []
    for owner in range(count):
        faces = [occ_surface(occ, piece) for piece_owner, piece in pieces if piece_owner == owner]
        solids.append((3, occ.addVolume([occ.addSurfaceLoop(faces, sewing=True)])))
    union, _ = occ.fuse(solids[:1], solids[1:])
    if half:
        box = occ.addBox(-FAR, 0, -FAR, 2 * FAR, FAR, 2 * FAR)
        union, _ = occ.intersect(union, [(3, box)])
    if len(union) != 1:
        raise RuntimeError(f"the components' union has {len(union)} bodies, not one")
    occ.synchronize()
    keep = {f for _, f in gmsh.model.getBoundary(union, oriented=False)}
    occ.remove(union)
    occ.synchronize()
    occ.remove([(2, f) for _, f in gmsh.model.getEntities(2) if f not in keep], recursive=True)
    occ.synchronize()


def _take_mesh(half):
    """Vertices in use, cells and the face of each; faces in the symmetry plane are left out."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = np.full(int(tags.max()) + 1, -1)
    number[tags.astype(int)] = np.arange(len(tags))
    vertices = coordinates.reshape(-1, 3)
    cells, face = [], []
    for _, tag in gmsh.model.getEntities(2):
        kinds, _, nodes = gmsh.model.mesh.getElements(2, tag)
        block = np.concatenate([_four(number[n.astype(int)], kind) for kind, n in zip(kinds, nodes)])
        if half and np.abs(vertices[block][..., 1]).max() < 1e-9:
            continue
        cells.append(block)
        face.append(np.full(len(block), tag))
    cells, face = np.concatenate(cells), np.concatenate(face)
    used, inverse = np.unique(cells, return_inverse=True)
    return vertices[used], inverse.reshape(cells.shape), face


def _four(nodes, kind):
    triangle = kind == 2
    cells = nodes.reshape(-1, 3 if triangle else 4)
    return np.c_[cells, cells[:, 2]] if triangle else cells


def _outward(vertices, cells, face, cell_piece, pieces):
    """Turns the cells of the faces that gmsh wound against S_u x S_v."""
    cells = cells.copy()
    normal = quality.area_normal(vertices, cells)
    for tag in np.unique(face):
        mine = np.flatnonzero(face == tag)
        patch = pieces[cell_piece[mine[0]]][1]
        foot = patch.closest(vertices[cells[mine]].mean(1))
        if (normal[mine] * patch.jet(foot.u, foot.v).unit_normal()).sum() < 0:
            turned = cells[mine][:, ::-1]
            triangle = quality.is_triangle(cells[mine])
            turned[triangle] = cells[mine][triangle][:, [1, 0, 2, 2]]
            cells[mine] = turned
    return cells


def _onto_patches(vertices, cells, cell_piece, pieces, half):
    """Moves every vertex onto all patches around it (and y = 0 on an open boundary): least moves, by Newton's method."""
    vertices = vertices.copy()
    meets = np.zeros((len(vertices), len(pieces) + 1), bool)
    meets[cells.ravel(), np.repeat(cell_piece, 4)] = True
    if half:
        directed = np.stack([cells, np.roll(cells, -1, axis=1)], -1).reshape(-1, 2)
        edges, uses = np.unique(np.sort(directed[directed[:, 0] != directed[:, 1]], axis=1), axis=0, return_counts=True)
        rim = np.unique(edges[uses == 1])
        if np.abs(vertices[rim, 1]).max() > CAD_TOLERANCE:
            raise RuntimeError("the half mesh is open away from y = 0")
        meets[rim, -1] = True
    points = poles([piece for _, piece in pieces])
    at_pole = np.zeros(len(vertices), bool)
    for point in points:
        near = np.linalg.norm(vertices - point, axis=1) < CAD_TOLERANCE
        vertices[near], at_pole = point, at_pole | near
    for pattern in np.unique(meets[~at_pole], axis=0):
        rows = np.flatnonzero((meets == pattern).all(1) & ~at_pole)
        x = vertices[rows]
        for _ in range(8):
            normals, gaps = [], []
            for k in np.flatnonzero(pattern[:-1]):
                patch = pieces[k][1]
                foot = patch.closest(x)
                normal = patch.jet(foot.u, foot.v).unit_normal()
                normals.append(normal)
                gaps.append(((foot.position - x) * normal).sum(1))
            if pattern[-1]:
                normals.append(np.tile([0.0, 1.0, 0.0], (len(x), 1)))
                gaps.append(-x[:, 1])
            x = x + np.einsum("nij,nj->ni", np.linalg.pinv(np.stack(normals, 1), rcond=1e-4), np.stack(gaps, 1))
        if pattern[-1]:
            x[:, 1] = 0.0
        vertices[rows] = x
    return vertices


def _split_flat(vertices, cells, cell_piece, limit=130.0):
    """Splits quads with an angle above the limit (degrees) at the diagonal that leaves the smaller largest angle."""
    worst = lambda c: np.nanmax(quality.corner_angles(vertices, c), axis=1)
    flat = ~quality.is_triangle(cells) & (worst(cells) > limit)
    a, b, c, d = cells[flat].T
    pairs = [np.stack([[a, b, c, c], [a, c, d, d]], 0), np.stack([[a, b, d, d], [b, c, d, d]], 0)]
    halves = [[np.ascontiguousarray(triangle.T) for triangle in pair] for pair in pairs]
    first_better = np.maximum(*map(worst, halves[0])) <= np.maximum(*map(worst, halves[1]))
    split = [np.where(first_better[:, None], one, other) for one, other in zip(*halves)]
    return np.concatenate([cells[~flat], *split]), np.concatenate(
        [cell_piece[~flat], cell_piece[flat], cell_piece[flat]]
    )


def check(components, mesh: Mesh, half: bool):
    """Largest distance of vertices from the components that they belong to, and the counts in the readme."""
    uses = np.stack(
        [
            np.bincount(mesh.cells[mesh.owner == k].ravel(), minlength=len(mesh.vertices)) > 0
            for k in range(len(components))
        ]
    )
    off = 0.0
    for k, component in enumerate(components):
        off = max(off, component.closest(mesh.vertices[uses[k]], within=1.0).distance.max())
    directed = np.stack([mesh.cells, np.roll(mesh.cells, -1, axis=1)], -1).reshape(-1, 2)
    directed = directed[directed[:, 0] != directed[:, 1]]
    edges, times = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    _, repeated = np.unique(directed, axis=0, return_counts=True)
    result = dict(
        vertices=len(mesh.vertices),
        cells=len(mesh.cells),
        triangles=int(quality.is_triangle(mesh.cells).sum()),
        seam_vertices=int((uses.sum(0) == 2).sum()),
        triple_points=int((uses.sum(0) == 3).sum()),
        open_edges=int((times == 1).sum()),
        non_manifold_edges=int((times > 2).sum()),
        inconsistent_edges=int((repeated > 1).sum()),
        euler=int(len(mesh.vertices) - len(edges) + len(mesh.cells)),
        largest_distance=float(off),
        quality=quality.summary(mesh.vertices, mesh.cells),
    )
    bad = result["non_manifold_edges"] or result["inconsistent_edges"] or (result["open_edges"] and not half)
    if bad or off > 1e-12:
        raise RuntimeError(f"the mesh fails its checks: {result}")
    return result


def write_vtu(path, mesh: Mesh):
    """VTK unstructured grid, ASCII, coordinates with 17 significant digits."""
    triangle = quality.is_triangle(mesh.cells)
    length = np.where(triangle, 3, 4)
    numbers = lambda values: " ".join(str(v) for v in values)
    array = lambda kind, name, text, more="": (
        f'<DataArray type="{kind}" Name="{name}"{more} format="ascii">\n{text}\n</DataArray>'
    )
    text = "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">',
            f'<UnstructuredGrid><Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfCells="{len(mesh.cells)}">',
            "<Points>",
            array(
                "Float64",
                "Points",
                "\n".join("{:.17g} {:.17g} {:.17g}".format(*x) for x in mesh.vertices),
                ' NumberOfComponents="3"',
            ),
            "</Points>",
            "<Cells>",
            array("Int64", "connectivity", "\n".join(numbers(c[:n]) for c, n in zip(mesh.cells, length))),
            array("Int64", "offsets", numbers(np.cumsum(length))),
            array("UInt8", "types", numbers(np.where(triangle, 5, 9))),
            "</Cells>",
            "</Piece></UnstructuredGrid>",
            "</VTKFile>",
            "",
        ]
    )
    Path(path).write_text(text)


def write_msh22(path, mesh: Mesh):
    """Gmsh MSH 2.2, ASCII, one physical group per component, coordinates with 17 significant digits."""
    triangle = quality.is_triangle(mesh.cells)
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(mesh.names))]
    lines += [f'2 {k + 1} "{name}"' for k, name in enumerate(mesh.names)]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(mesh.vertices))]
    lines += ["{} {:.17g} {:.17g} {:.17g}".format(i + 1, *x) for i, x in enumerate(mesh.vertices)]
    lines += ["$EndNodes", "$Elements", str(len(mesh.cells))]
    for i, (cell, is_triangle, owner) in enumerate(zip(mesh.cells, triangle, mesh.owner)):
        nodes = " ".join(str(n + 1) for n in cell[: 3 if is_triangle else 4])
        lines.append(f"{i + 1} {2 if is_triangle else 3} 2 {owner + 1} {owner + 1} {nodes}")
    lines += ["$EndElements", ""]
    Path(path).write_text("\n".join(lines))
