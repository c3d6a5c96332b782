"""The conforming quad-dominant mesh of the union of fuselage, wing and tail.

The starboard half is built in blocks and mirrored:
- wing and tail: a structured grid from the seam to the tip, chordwise lines at constant u, so that every strip keeps its
  place on the section whatever the wing does; the flat tip is filled with quads across the thickness;
- fuselage: lines along the axis and around it, with a C-shaped layer of quads about each seam and a square block over each
  pole. The blocks are laid out in the plane (xi, theta) in which a body of revolution is conformal, and their shape is
  then optimised on the surface. A wing that slides and rotates stretches and squeezes such cells along their
  edges, which keeps them rectangles.
Vertices are evaluated on the patches, seam vertices solved on both bodies, so nothing is off its surface by more than
rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

import quality
from bspline import Component, Patch
from optimise import optimise


@dataclass(frozen=True)
class Counts:
    """Numbers of cells along the blocks of the half mesh."""

    around: int  # fuselage, bottom to top; divisible by 4
    layer: int  # thickness of the C layers
    fore: int  # fuselage columns: nose block to wing layer
    between: int  # wing trailing edge to tail layer
    aft: int  # tail trailing edge to tail block
    wing_chord: int  # on each side
    wing_span: int
    tail_chord: int
    tail_span: int

    @staticmethod
    def scaled(factor):
        """The counts of the 15,000-cell mesh times a factor."""
        times = lambda n: max(1, round(n * factor))
        return Counts(
            4 * times(5), times(1), times(42), times(42), times(26), times(18), times(86), times(17), times(35)
        )

    @property
    def wing_line(self):
        """Which line along the fuselage, counted from the bottom, carries the wing."""
        return round(0.30 * self.around)

    @property
    def tail_line(self):
        return round(0.53 * self.around)

    def cells(self):
        """Cells of the whole mesh but for the tips."""
        columns = self.fore + self.between + self.aft + self.wing_chord + self.tail_chord
        fuselage = columns * self.around + self.around**2 // 4
        surfaces = 2 * (self.wing_chord * self.wing_span + self.tail_chord * self.tail_span)
        return 2 * (fuselage + surfaces)

    @staticmethod
    def for_cells(wanted):
        """The counts whose mesh comes nearest to the wanted number of cells."""
        factors = np.sqrt(wanted / Counts.scaled(1).cells()) * np.linspace(0.8, 1.25, 451)
        return min(map(Counts.scaled, factors), key=lambda c: abs(c.cells() - wanted))


@dataclass
class Mesh:
    """Vertices [n, 3]; cells [m, 4], a triangle repeating its third vertex; owner component per cell; named edge lines."""

    vertices: np.ndarray
    cells: np.ndarray
    owner: np.ndarray
    names: list[str]
    lines: dict[str, np.ndarray] = field(default_factory=dict)


class HalfMesh:
    """The starboard half while it grows."""

    def __init__(self):
        self.vertices = np.empty((0, 3))
        self.cells, self.owner, self.lines = [], [], {}

    def add_vertices(self, positions):
        first = len(self.vertices)
        self.vertices = np.concatenate([self.vertices, positions])
        return np.arange(first, len(self.vertices))

    def add_cells(self, cells, owner):
        self.cells.append(np.asarray(cells))
        self.owner.append(np.full(len(cells), owner))

    def add_line(self, name, vertices):
        self.lines.setdefault(name, []).append(np.c_[vertices[:-1], vertices[1:]])

    def mirrored(self, names):
        """The whole mesh: the half, and its mirror image joined at y = 0."""
        count = len(self.vertices)
        on_plane = self.vertices[:, 1] == 0
        image = np.where(on_plane, np.arange(count), count - 1 + np.cumsum(~on_plane))
        vertices = np.concatenate([self.vertices, self.vertices[~on_plane] * [1, -1, 1]])
        cells, owner = np.concatenate(self.cells), np.concatenate(self.owner)
        opposite = image[cells]
        quad = ~quality.is_triangle(cells)
        opposite[quad] = opposite[quad][:, ::-1]
        opposite[~quad] = opposite[~quad][:, [1, 0, 2, 2]]
        lines = {}
        for name, pieces in self.lines.items():
            line = np.concatenate(pieces)
            lines[name] = np.concatenate([line, image[line][:, ::-1]])
        return Mesh(vertices, np.concatenate([cells, opposite]), np.concatenate([owner, owner]), list(names), lines)


def grid_cells(ids):
    """Quads of a grid of vertex numbers [i, j]; edges 0 and 2 run along i, and the cell winds from i to j."""
    return np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(-1, 4)


# --- lifting surfaces -------------------------------------------------------------------------------------------------


class LiftingSurface:
    """Chordwise stations of a wing: 0 at the lower trailing edge, `chord` at the leading edge, 2 chord at the upper one."""

    # relative cell sizes along the section against arc length from trailing (0) to leading edge (1)
    SIZES = ((0, 0.8), (0.15, 1.0), (0.5, 1.1), (0.8, 1.0), (1, 0.7))

    def __init__(self, component: Component, chord: int):
        self.component, self.chord = component, chord
        self.lower, self.upper, _, self.cap = component.patches
        self.half_span = component.patches[0].control_points[0, -1, 1]
        u = self._stations()
        self.on_upper = np.arange(2 * chord + 1) > chord
        self.u = np.concatenate([u, 1 - u[-2::-1]])

    def _stations(self):
        """u of the lower skin's stations, from the arc length of its section at a third of the half span."""
        u = np.linspace(0, 1, 2001)
        line = self.lower.position(u, np.full_like(u, 0.5 + 0.5 / 3))
        arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        arc /= arc[-1]
        density = 1 / np.interp(arc, *np.array(self.SIZES).T)
        number = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(arc))])
        stations = np.interp(np.linspace(0, number[-1], self.chord + 1), number, u)
        stations[0], stations[-1] = 0.0, 1.0
        return stations

    def jet(self, y, stations=None):
        """Surface jets at the stations and spanwise positions y (arrays of one length); v is linear in y."""
        stations = np.arange(len(self.u)) if stations is None else stations
        v = 0.5 * (1 + y / self.half_span)
        u = self.u[stations]
        return self.upper.jet(u, v).where(self.on_upper[stations], self.lower.jet(u, v))

    def seam(self, body: Patch, start):
        """y of the points in which the spanwise lines leave the body, their positions, and their (u, v) on the body."""
        y = np.full(len(self.u), float(start))
        foot = body.closest(self.jet(y).position)
        u, v = foot.u, foot.v
        for _ in range(12):
            wing = self.jet(y)
            u, v, nearest = body.refine(wing.position, u, v)
            normal = body.jet(u, v).unit_normal()
            height = ((wing.position - nearest) * normal).sum(1)
            y = y - height / ((wing.v * normal).sum(1) / (2 * self.half_span))
        if np.abs(height).max() > 1e-13:
            raise RuntimeError(f"{self.component.name}: the seam does not converge: {np.abs(height).max():.1e} m")
        y[-1] = y[0]  # the trailing edge, met from both sides
        position = self.jet(y).position
        position[-1] = position[0]
        return y, position, u, v

    def mesh(self, half: HalfMesh, seam_y, seam_ids, span: int, owner: int):
        """Skin and tip cells from the seam outwards."""
        name = self.component.name
        inner = seam_y.mean()
        fine = np.linspace(inner, self.half_span, 4001)
        chord = np.linalg.norm(
            self.lower.position(np.zeros_like(fine), 0.5 * (1 + fine / self.half_span))
            - self.lower.position(np.ones_like(fine), 0.5 * (1 + fine / self.half_span)),
            axis=1,
        )
        number = np.concatenate([[0], np.cumsum(0.5 * (1 / chord[1:] + 1 / chord[:-1]) * np.diff(fine))])
        rows = np.interp(np.linspace(0, number[-1], span + 1), number, fine)
        rows[-1] = self.half_span
        # the rows take the shape of the seam at the root and straighten out over 45% of the span
        fraction = np.clip((rows - inner) / (0.45 * (self.half_span - inner)), 0, 1)
        bend = (1 - fraction) ** 3 * (1 + 3 * fraction)
        y = rows + np.outer(seam_y - inner, bend)

        stations = len(self.u)
        ids = np.empty((stations, span + 1), int)
        ids[:, 0] = seam_ids
        position = self.jet(y[:-1, 1:].ravel(), np.repeat(np.arange(stations - 1), span)).position
        ids[:-1, 1:] = half.add_vertices(position).reshape(stations - 1, span)
        ids[-1] = ids[0]
        half.add_cells(grid_cells(ids), owner)
        half.add_line(f"leading_edge_{name}", ids[self.chord])
        half.add_line(f"trailing_edge_{name}", ids[0])
        half.add_line(f"tip_{name}", ids[:, -1])
        self._tip(half, ids[:, -1], owner)

    def _tip(self, half, rim, owner):
        """Fills the flat tip: lines from the lower to the upper rim, one more cell on them where the section is thicker."""
        low, high = rim[: self.chord + 1], rim[: self.chord - 1 : -1]
        thickness = np.linalg.norm(half.vertices[low] - half.vertices[high], axis=1)
        step = np.linalg.norm(np.diff(half.vertices[low], axis=0), axis=1).mean()
        across = np.maximum(1, np.round(thickness / step)).astype(int)
        across[0] = across[-1] = 0
        for order in (range(1, len(across)), range(len(across) - 2, -1, -1)):  # neighbours differ by one at most
            for k in order:
                before = across[k - 1] if order.step == 1 else across[k + 1]
                across[k] = min(across[k], before + 1)
        lines = [low[:1]]
        for k in range(1, self.chord):
            v = np.arange(1, across[k]) / across[k]
            inner = half.add_vertices(self.cap.position(np.full(len(v), self.u[k]), v)) if len(v) else []
            lines.append(np.concatenate([low[k : k + 1], inner, high[k : k + 1]]).astype(int))
        lines.append(low[-1:])
        cells = np.array([cell for a, b in pairwise(lines) for cell in _strip(a, b)])
        outward = quality.area_normal(half.vertices, cells)[:, 1].sum() > 0
        half.add_cells(cells if outward else _reversed(cells), owner)


def _strip(a, b):
    """Cells between two lines of vertices whose counts differ by at most one; a triangle in the middle if they do."""
    if len(a) == len(b):
        return [(a[k], b[k], b[k + 1], a[k + 1]) for k in range(len(a) - 1)]
    if len(a) > len(b):
        return [cell for cell in _reversed(np.array(_strip(b, a)))]
    middle = (len(a) - 1) // 2
    before = [(a[k], b[k], b[k + 1], a[k + 1]) for k in range(middle)]
    after = [(a[k], b[k + 1], b[k + 2], a[k + 1]) for k in range(middle, len(a) - 1)]
    return [*before, (a[middle], b[middle], b[middle + 1], b[middle + 1]), *after]


def _reversed(cells):
    turned = cells[:, ::-1].copy()
    triangle = quality.is_triangle(cells)
    turned[triangle] = cells[triangle][:, [1, 0, 2, 2]]
    return turned


# --- fuselage ---------------------------------------------------------------------------------------------------------


@dataclass
class Slit:
    """A seam on the fuselage: its vertices from lower to upper trailing edge, and the line along the fuselage it sits on."""

    line: int
    chord: int
    ids: np.ndarray
    u: np.ndarray
    v: np.ndarray


class FuselageGrid:
    """Columns i along the axis from nose block to tail block, lines j from bottom (0) to top (`around`)."""

    NOSE_BLOCK, TAIL_BLOCK = 0.62, 0.24  # m along the surface from the pole to the edge of the block

    def __init__(self, patch: Patch, counts: Counts, wing: Slit, tail: Slit):
        self.patch, self.n = patch, counts
        # the conformal coordinate xi(u): d xi = ds / mean radius, from the starboard meridian and the half perimeters
        self.table_u = np.linspace(0, 1, 3001)
        meridian = patch.position(self.table_u, np.full(3001, 0.75))
        self.table_s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(meridian, axis=0), axis=1))])
        around = np.stack([patch.position(self.table_u, np.full(3001, v)) for v in np.linspace(0.5, 1, 65)])
        radius = np.linalg.norm(np.diff(around, axis=0), axis=2).sum(0) / np.pi
        rate = 1 / np.maximum(radius, 1e-4)
        self.table_xi = np.concatenate([[0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(self.table_s))])
        front_wing = counts.fore
        front_tail = front_wing + wing.chord - counts.layer + counts.between
        self.columns = front_tail + tail.chord - counts.layer + counts.aft
        self.slits = [(front_wing, wing), (front_tail, tail)]

    def mesh(self, half: HalfMesh, owner: int, log):
        n, layer = self.n, self.n.layer
        first = len(half.vertices)
        u = np.concatenate([slit.u for _, slit in self.slits])
        v = np.concatenate([slit.v for _, slit in self.slits])
        seam = np.concatenate([slit.ids for _, slit in self.slits])
        plane = {}  # vertex number -> (xi, theta) of those laid out

        # numbers of the regular lines; the inside of a slit's box is left out
        ids = np.zeros((self.columns + 1, n.around + 1), int)
        for front, slit in self.slits:
            back = front + slit.chord - layer
            ids[front + 1 : back, slit.line - layer + 1 : slit.line + layer] = -1
            ids[back, slit.line] = -1
        regular = ids == 0
        ids[regular] = first + np.arange(regular.sum())
        count = first + regular.sum()
        cells = []
        keep = np.ones((self.columns, n.around), bool)
        for front, slit in self.slits:
            back = front + slit.chord - layer
            ids[back, slit.line] = slit.ids[0]
            keep[front:back, slit.line - layer : slit.line + layer] = False
        cells.append(_reversed_grid(ids)[keep.ravel()])

        # a layer of quads around each slit
        for front, slit in self.slits:
            back = front + slit.chord - layer
            low, high = slit.line - layer, slit.line + layer
            c = np.full((2 * slit.chord + 1, layer + 1), -1)
            c[:, 0] = slit.ids
            c[:, layer] = np.concatenate([ids[back:front:-1, low], ids[front, low:high], ids[front : back + 1, high]])
            c[0], c[-1] = ids[back, low : slit.line + 1][::-1], ids[back, slit.line : high + 1]
            inner = c == -1
            c[inner] = count + np.arange(inner.sum())
            count += inner.sum()
            offset = self._offsets(slit)
            for step in range(1, layer + 1):
                plane.update(zip(c[:, step], offset(step)))
            cells.append(_reversed_grid(c))

        # the block over each pole; its rim is the first or last column
        blocks = []
        quarter = n.around // 4
        for column, size, outward_x in ((0, self.NOSE_BLOCK, -1), (self.columns, self.TAIL_BLOCK, 1)):
            b = np.full((quarter + 1, 2 * quarter + 1), -1)
            b[:, 0] = ids[column, : quarter + 1]
            b[-1, :] = ids[column, quarter : 3 * quarter + 1]
            b[:, -1] = ids[column, 3 * quarter :][::-1]
            inner = b == -1
            b[inner] = count + np.arange(inner.sum())
            count += inner.sum()
            cells.append(_reversed_grid(b) if outward_x < 0 else grid_cells(b))
            blocks.append((b, self._block(quarter, size, outward_x)))

        # layout in the plane: harmonic between the ends, the layers and the meridians
        for column, (_, (block_u, _)) in zip((0, self.columns), blocks):
            rim = np.full(n.around + 1, self._xi(block_u[0, 0]))
            plane.update(zip(ids[column], np.c_[rim, np.linspace(0, np.pi, n.around + 1)]))
        xi, theta = self._harmonic(ids, plane, first, count)
        new_u = np.interp(xi, self.table_xi, self.table_u)
        new_v = 1 - theta / (2 * np.pi)
        for b, (block_u, block_theta) in blocks:
            new_u[b - first], new_v[b - first] = block_u, 1 - block_theta / (2 * np.pi)

        # one numbering for seams (in front) and new vertices
        number = np.full(count, -1)
        number[seam], number[first:] = np.arange(len(seam)), len(seam) + np.arange(count - first)
        all_cells = np.concatenate(cells)
        local = number[all_cells]
        all_u, all_v = np.concatenate([u, new_u]), np.concatenate([v, new_v])
        fixed = np.zeros(len(all_u), bool)
        fixed[: len(seam)] = True
        meridian = np.zeros(len(all_u), bool)
        for edge in (ids[:, 0], ids[:, -1], blocks[0][0][0], blocks[1][0][0]):
            meridian[number[edge]] = True
        for b, _ in blocks:
            fixed[number[b[0, quarter]]] = True
        target = np.ones(len(local))
        all_u, all_v = optimise(self.patch, all_u, all_v, local, target, fixed, meridian, rounds=24, log=log)
        position = self.patch.position(all_u, all_v)[len(seam) :]
        position[meridian[len(seam) :], 1] = 0.0
        half.add_vertices(position)
        half.add_cells(all_cells, owner)

    def _xi(self, u):
        return np.interp(u, self.table_u, self.table_xi)

    def _offsets(self, slit):
        """Plane positions of the layer's vertices around a slit: function of the number of steps off the seam."""
        points = np.c_[self._xi(slit.u), 2 * np.pi * (1 - slit.v)]
        ahead, behind = np.roll(points, -1, axis=0), np.roll(points, 1, axis=0)
        tangent = ahead - behind
        normal = np.c_[tangent[:, 1], -tangent[:, 0]]
        normal[0], normal[-1] = (0, -1), (0, 1)
        normal[1:-1] *= np.sign(-normal[1, 1])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        step_size = np.pi / self.n.around
        return lambda step: points + step * step_size * normal

    def _block(self, quarter, size, outward_x):
        """(u, theta) of a square block over a pole, [across, upwards]."""
        p = np.arange(quarter + 1)[:, None] / quarter
        q = np.arange(-quarter, quarter + 1)[None, :] / quarter
        rho = np.maximum(p, np.abs(q))
        with np.errstate(invalid="ignore"):
            side = np.pi / 2 + np.pi / 4 * q / rho
            end = np.pi / 4 * p / rho
        theta = np.where(p >= np.abs(q), side, np.where(q < 0, end, np.pi - end))
        theta[0, quarter] = np.pi / 2
        s = rho * size
        s = s if outward_x < 0 else self.table_s[-1] - s
        return np.interp(s, self.table_s, self.table_u), theta

    def _harmonic(self, ids, plane, first, count):
        """(xi, theta) of all new vertices: the mean of the neighbours along the lines, where not laid out already."""
        known = np.zeros(count, bool)
        value = np.zeros((count, 2))
        for vertex, at in plane.items():
            known[vertex], value[vertex] = True, at
        top = {**dict.fromkeys(ids[:, 0], 0.0), **dict.fromkeys(ids[:, -1], np.pi)}
        pairs = np.concatenate(
            [np.stack([ids[:-1], ids[1:]], -1).reshape(-1, 2), np.stack([ids[:, :-1], ids[:, 1:]], -1).reshape(-1, 2)]
        )
        pairs = pairs[(pairs >= 0).all(1)]
        for slit in (slit for _, slit in self.slits):
            known[slit.ids] = True
            value[slit.ids] = np.c_[self._xi(slit.u), 2 * np.pi * (1 - slit.v)]
        involved = np.zeros(count, bool)
        involved[pairs] = True
        for axis in range(2):
            held = known.copy()
            if axis == 1:
                for vertex, angle in top.items():
                    held[vertex], value[vertex, 1] = True, angle
            unknown = np.flatnonzero(involved & ~held)
            number = np.full(count, -1)
            number[unknown] = np.arange(len(unknown))
            a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
            row = number[a] >= 0
            a, b = a[row], b[row]
            inside = number[b] >= 0
            size = (len(unknown),) * 2
            matrix = coo_matrix((np.ones(len(a)), (number[a], number[a])), size) - coo_matrix(
                (np.ones(inside.sum()), (number[a[inside]], number[b[inside]])), size
            )
            load = np.bincount(number[a[~inside]], value[b[~inside], axis], len(unknown))
            value[unknown, axis] = spsolve(matrix.tocsc(), load)
        return value[first:, 0], value[first:, 1]


def _reversed_grid(ids):
    """As grid_cells, wound the other way; edges 0 and 2 still run along i."""
    return np.stack([ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1], ids[:-1, :-1]], axis=-1).reshape(-1, 4)


# --- the whole --------------------------------------------------------------------------------------------------------


def build(components, counts: Counts, log=lambda text: None) -> Mesh:
    """The mesh of the union of [fuselage, wing, tail]."""
    fuselage, wing, tail = components
    body = fuselage.patches[0]
    half = HalfMesh()
    slits, pending = [], []
    for owner, component, chord, span, line, start in (
        (1, wing, counts.wing_chord, counts.wing_span, counts.wing_line, 1.4),
        (2, tail, counts.tail_chord, counts.tail_span, counts.tail_line, 0.75),
    ):
        surface = LiftingSurface(component, chord)
        y, position, u, v = surface.seam(body, start)
        ids = np.append(half.add_vertices(position[:-1]), -1)
        ids[-1] = ids[0]
        half.add_line(f"seam_fuselage_{component.name}", ids)
        slits.append(Slit(line, chord, ids, u, v))
        pending.append((surface, y, ids, span, owner))
    FuselageGrid(body, counts, *slits).mesh(half, 0, log)
    for surface, y, ids, span, owner in pending:
        surface.mesh(half, y, ids, span, owner)
    return half.mirrored([c.name for c in components])


def write_msh(path, mesh: Mesh):
    """Gmsh MSH 4.1, ASCII, coordinates with 17 significant digits, physical groups for components and lines."""
    groups = [(2, k + 1, name, k + 1) for k, name in enumerate(mesh.names)]
    groups += [(1, 101 + k, name, 1 + k) for k, name in enumerate(mesh.lines)]
    box = lambda points: " ".join(f"{x:.17g}" for x in (*points.min(0), *points.max(0)))
    out = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    out += [f'{dimension} {tag} "{name}"' for dimension, tag, name, _ in groups]
    out += ["$EndPhysicalNames", "$Entities", f"0 {len(mesh.lines)} {len(mesh.names)} 0"]
    for k, line in enumerate(mesh.lines.values()):
        out.append(f"{k + 1} {box(mesh.vertices[line].reshape(-1, 3))} 1 {101 + k} 0")
    for k in range(len(mesh.names)):
        out.append(f"{k + 1} {box(mesh.vertices[mesh.cells[mesh.owner == k]].reshape(-1, 3))} 1 {k + 1} 0")
    # every vertex belongs to the surface of the first component that uses it
    home = np.full(len(mesh.vertices), len(mesh.names))
    for k in reversed(range(len(mesh.names))):
        home[mesh.cells[mesh.owner == k]] = k
    out += ["$EndEntities", "$Nodes", f"{len(mesh.names)} {len(mesh.vertices)} 1 {len(mesh.vertices)}"]
    for k in range(len(mesh.names)):
        own = np.flatnonzero(home == k)
        out.append(f"2 {k + 1} 0 {len(own)}")
        out += [str(i + 1) for i in own]
        out += ["{:.17g} {:.17g} {:.17g}".format(*mesh.vertices[i]) for i in own]
    blocks = [(1, k + 1, 1, line) for k, line in enumerate(mesh.lines.values())]
    triangle = quality.is_triangle(mesh.cells)
    for k in range(len(mesh.names)):
        mine = mesh.owner == k
        blocks += [(2, k + 1, 3, mesh.cells[mine & ~triangle]), (2, k + 1, 2, mesh.cells[mine & triangle][:, :3])]
    blocks = [block for block in blocks if len(block[3])]
    total = sum(len(block[3]) for block in blocks)
    out += ["$EndNodes", "$Elements", f"{len(blocks)} {total} 1 {total}"]
    tag = 1
    for dimension, entity, kind, elements in blocks:
        out.append(f"{dimension} {entity} {kind} {len(elements)}")
        for element in elements:
            out.append(f"{tag} " + " ".join(str(i + 1) for i in element))
            tag += 1
    out += ["$EndElements", ""]
    with open(path, "w", newline="\n") as file:
        file.write("\n".join(out))
