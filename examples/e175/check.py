"""Checks of the geometry and the mesh, gathered in one report: measures specified and obtained."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import geometry
import quality
from bspline import Component, Patch
from cad import occ_surface
from mesh import Mesh

# --- geometry ---------------------------------------------------------------------------------------------------------


def _edge(wing: Component, y, u):
    """Point of the lower skin at span y: u = 0 on the trailing edge, 1 on the leading edge."""
    lower = wing.patches[0]
    half_span = lower.control_points[0, -1, 1]
    y = np.atleast_1d(np.asarray(y, float))
    return lower.position(np.full_like(y, u), 0.5 * (1 + y / half_span))


def planform(wing: Component):
    """Area, aspect ratio, mean aerodynamic chord and x of its quarter point, of the planform through the body."""
    y = np.linspace(0, wing.patches[0].control_points[0, -1, 1], 20001)
    leading, trailing = _edge(wing, y, 1.0), _edge(wing, y, 0.0)
    chord = trailing[:, 0] - leading[:, 0]
    area = 2 * np.trapezoid(chord, y)
    mean = 2 * np.trapezoid(chord**2, y) / area
    quarter = 2 * np.trapezoid((leading[:, 0] + 0.25 * chord) * chord, y) / area
    return area, (2 * y[-1]) ** 2 / area, mean, quarter


def measures(components):
    """Rows (name, specified, obtained) of the published measures."""
    fuselage, wing, tail = components
    body = fuselage.patches[0]
    grid = np.meshgrid(np.linspace(0, 1, 1601), np.linspace(0, 1, 129), indexing="ij")
    points = body.position(*(g.ravel() for g in grid))
    rows = [
        ("fuselage length", 31.68, np.ptp(points[:, 0])),
        ("fuselage half width", 1.505, points[:, 1].max()),
        ("fuselage lowest z", -0.725, points[:, 2].min()),
        ("fuselage highest z", 2.625, points[:, 2].max()),
        ("fuselage aft end (x, y, z)", [31.68, 0.0, 1.90], body.position(1.0, 0.75)[0]),
    ]
    for name, component, stations in (("wing", wing, geometry.WING_STATIONS), ("tail", tail, geometry.TAIL_STATIONS)):
        for station in stations:
            for edge, u, asked in (("leading", 1.0, station.leading_edge), ("trailing", 0.0, station.trailing_edge)):
                got = _edge(component, station.y, u)[0]
                rows.append((f"{name} {edge} edge at y = {station.y} (x, z)", list(asked), got[[0, 2]]))
    for name, component, u, asked in (
        ("wing-body junction, leading edge (x, y, z)", wing, 1.0, [11.639, 1.402, 0.339]),
        ("wing-body junction, trailing edge (x, y, z)", wing, 0.0, [16.354, 1.329, 0.163]),
        ("tail-body junction, trailing edge (x, y)", tail, 0.0, [29.689, 0.605]),
    ):
        got = _leaves_body(component, body, u, asked[1])
        rows.append((name, asked, got[: len(asked)]))
    area, ratio, mean, quarter = planform(wing)
    tail_area, tail_ratio, _, tail_quarter = planform(tail)
    rows += [
        ("wing area S_W", 68.2, area),
        ("wing aspect ratio", 8.33, ratio),
        ("wing mean aerodynamic chord", 3.42, mean),
        ("tail area S_T", 23.25, tail_area),
        ("tail aspect ratio", 4.30, tail_ratio),
        ("tail arm, quarter chord to quarter chord", 14.0, tail_quarter - quarter),
    ]
    return [
        dict(name=n, asked=a, got=np.asarray(g).tolist(), difference=float(np.abs(np.asarray(g) - a).max()))
        for n, a, g in rows
    ]


def _signed_distance(body: Patch, points):
    foot = body.closest(points)
    normal = body.jet(foot.u, foot.v).unit_normal()
    side = ((points - foot.position) * normal).sum(1)
    return np.where(side < 0, -foot.distance, foot.distance)


def _leaves_body(wing, body, u, start):
    low, high = start - 0.3, start + 0.3
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _signed_distance(body, _edge(wing, middle, u))[0] < 0 else (low, middle)
    return _edge(wing, 0.5 * (low + high), u)[0]


def root_clearance(components):
    """Least depth of the wing's centre section inside the fuselage (m) for the motions that the mesh must follow.

    A negative depth would mean that the wing comes through the belly, and the seam would change its topology.
    """
    fuselage, wing, _ = components
    body = fuselage.patches[0]
    u = np.linspace(0, 1, 101)
    root = np.concatenate([patch.position(u, np.full_like(u, 0.5)) for patch in wing.patches[:2]])
    pivot = np.array([12.81775, 0.0, 0.25])
    cases = [(dx, degrees, 1.0) for dx in (-5, 0, 5) for degrees in (-10, 10)] + [
        (dx, 0, f) for dx in (-5, 0, 5) for f in (0.7, 1.5)
    ]
    rows = []
    for dx, degrees, diameter in cases:
        angle = np.radians(degrees)  # positive: nose up
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        section = (root - pivot) @ turn.T + pivot + [dx, 0, 0]
        net = body.control_points.copy()
        centre = 0.5 * (net.min(1, keepdims=True) + net.max(1, keepdims=True))
        net[..., 1:] = (centre + diameter * (net - centre))[..., 1:]
        scaled = Patch("body", 3, 3, body.knots_u, body.knots_v, net)
        rows.append(
            dict(
                translation=dx,
                rotation=degrees,
                diameter=diameter,
                depth=float(-_signed_distance(scaled, section).max()),
            )
        )
    return rows


# --- mesh -------------------------------------------------------------------------------------------------------------


def _edges(cells):
    """Directed edges of all cells, [edge, 2]."""
    directed = np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2)
    return directed[directed[:, 0] != directed[:, 1]]


def topology(mesh: Mesh):
    """Euler number, and edges that are open, shared by more than two cells, or run through twice in one direction."""
    directed = _edges(mesh.cells)
    unique, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    _, same_direction = np.unique(directed, axis=0, return_counts=True)
    corners = mesh.vertices[mesh.cells]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) + np.einsum(
        "ij,ij->i", corners[:, 0], np.cross(corners[:, 2], corners[:, 3])
    )
    return dict(
        vertices=len(mesh.vertices),
        unused_vertices=int(len(mesh.vertices) - len(np.unique(mesh.cells))),
        edges=len(unique),
        cells=len(mesh.cells),
        euler=int(len(mesh.vertices) - len(unique) + len(mesh.cells)),
        open_edges=int((uses == 1).sum()),
        non_manifold_edges=int((uses > 2).sum()),
        inconsistent_edges=int((same_direction > 1).sum()),
        volume=float(volume.sum() / 6),
    )


def symmetry(mesh: Mesh):
    """Vertices and cells without a mirror image of exactly the same coordinates."""
    index = {tuple(x): i for i, x in enumerate((mesh.vertices + 0.0).tolist())}
    mirrored = [index.get((x, 0.0 - y, z), -1) for x, y, z in mesh.vertices.tolist()]
    image = np.array(mirrored)
    known = {tuple(sorted(cell)) for cell in mesh.cells.tolist()}
    missing = sum(tuple(sorted(cell)) not in known for cell in image[mesh.cells].tolist())
    return dict(
        vertices_without_image=int((image < 0).sum()),
        cells_without_image=missing,
        vertices_on_plane=int((mesh.vertices[:, 1] == 0).sum()),
    )


def distances(components, mesh: Mesh):
    """Closest-point distances of every vertex to each component that uses it; of seam vertices to both; cells whose
    Newell normal opposes their owner's."""
    uses = np.stack(
        [
            np.bincount(mesh.cells[mesh.owner == k].ravel(), minlength=len(mesh.vertices)) > 0
            for k in range(len(components))
        ]
    )
    report, opposed, least_cosine = {}, 0, 1.0
    worst = np.zeros(len(mesh.vertices))
    for k, component in enumerate(components):
        rows = np.flatnonzero(uses[k])
        foot = component.closest(mesh.vertices[rows], within=1.0, starts=2)
        worst[rows] = np.maximum(worst[rows], foot.distance)
        report[component.name] = float(foot.distance.max())
        cells = mesh.cells[mesh.owner == k]
        normal = quality.area_normal(mesh.vertices, cells)
        centre = mesh.vertices[cells].mean(1)
        foot = component.closest(centre, within=1.0, starts=1)
        surface = np.zeros_like(normal)
        for p, patch in enumerate(component.patches):
            mine = foot.patch == p
            u0, u1, _, _ = patch.domain
            surface[mine] = patch.jet(np.clip(foot.u[mine], u0 + 1e-6, u1 - 1e-6), foot.v[mine]).unit_normal()
        cosine = (normal * surface).sum(1) / np.linalg.norm(normal, axis=1)
        opposed += int((cosine <= 0).sum())
        least_cosine = min(least_cosine, float(cosine.min()))
    seam = uses.sum(0) > 1
    return dict(
        largest_distance=report,
        seam_vertices=int(seam.sum()),
        largest_seam_distance=float(worst[seam].max()),
        folded_cells=opposed,
        least_normal_agreement=least_cosine,
    )


def gmsh_check(path: Path, components, mesh: Mesh):
    """Reads the mesh file with gmsh, compares it bit for bit, and takes the volume of the union from OpenCASCADE."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 1)
    try:
        gmsh.open(str(path))
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        read = np.empty_like(mesh.vertices)
        read[tags.astype(int) - 1] = coordinates.reshape(-1, 3)
        groups = {gmsh.model.getPhysicalName(d, t): d for d, t in gmsh.model.getPhysicalGroups()}
        gmsh.clear()
        occ = gmsh.model.occ
        solids = []
        for component in components:
            faces = [occ_surface(occ, patch) for patch in component.patches]
            solids.append((3, occ.addVolume([occ.addSurfaceLoop(faces, sewing=True)])))
        union, _ = occ.fuse(solids[:1], solids[1:])
        volume = sum(occ.getMass(*solid) for solid in union)
        version = gmsh.option.getString("General.Version")
    finally:
        gmsh.finalize()
    return dict(
        gmsh=version, same_bits=bool((read == mesh.vertices).all()), physical_groups=groups, union_volume=volume
    )


def report(components, mesh: Mesh, path: Path):
    """All checks, as a dictionary for report.json."""
    result = dict(
        measures=measures(components),
        root_clearance=root_clearance(components),
        topology=topology(mesh),
        symmetry=symmetry(mesh),
        distances=distances(components, mesh),
        independent=gmsh_check(path, components, mesh),
        quality=dict(
            total=quality.summary(mesh.vertices, mesh.cells),
            **{name: quality.summary(mesh.vertices, mesh.cells[mesh.owner == k]) for k, name in enumerate(mesh.names)},
        ),
    )
    failures = []
    must = lambda condition, text: None if condition else failures.append(text)
    shape, mirror, total = result["topology"], result["symmetry"], result["quality"]["total"]
    must(shape["euler"] == 2, "Euler number is not 2")
    must(
        not any(shape[k] for k in ("open_edges", "non_manifold_edges", "inconsistent_edges", "unused_vertices")),
        "not a closed oriented manifold",
    )
    must(shape["volume"] > 0, "oriented inwards")
    must(not (mirror["vertices_without_image"] or mirror["cells_without_image"]), "not symmetric")
    must(
        max(result["distances"]["largest_distance"].values()) <= 1e-12,
        "vertices off their component by more than 1e-12 m",
    )
    must(result["distances"]["folded_cells"] == 0, "cells folded against their owner's normal")
    must(result["independent"]["same_bits"], "the mesh file does not hold the vertices' exact values")
    must(total["aspect_ratio"]["p95"] <= 1.45 and total["aspect_ratio"]["above_5"] == 0, "aspect ratios above the goal")
    must(min(row["depth"] for row in result["root_clearance"]) > 0, "the wing comes through the belly")
    result["failures"] = failures
    return result
