"""Draws surface meshes: orthographic, shaded, with their lines, in numpy alone (no OpenGL, no display).

image = render(vertices, cells, owner, colours, View(centre, towards, height), size=(1600, 1000))
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

#: Fourth entry of a triangle, as in the client's meshes.
NO_VERTEX = 0xFFFFFFFF
#: Pixels of the picture are means of squares of this many samples.
SAMPLES = 2
#: Samples rasterised at a time, to bound memory.
BATCH = 2_000_000
#: Normals are shared by neighbouring cells up to this angle.
CREASE = np.cos(np.radians(40.0))

INK = np.array([28, 34, 44]) / 255
SEAM_INK = np.array([196, 30, 58]) / 255


@dataclass(frozen=True)
class View:
    """An orthographic camera."""

    #: Point in the middle of the picture, metres.
    centre: tuple[float, float, float]
    #: Direction from there to the eye.
    towards: tuple[float, float, float]
    #: Height of the picture, metres.
    height: float
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def axes(self) -> NDArray[np.float64]:
        """Rows: right, up, towards the eye."""
        towards = np.array(self.towards, float) / np.linalg.norm(self.towards)
        right = np.cross(self.up, towards)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(towards, right), towards])


def render(
    vertices: NDArray[np.float64],
    cells: NDArray[np.uint32],
    owner: NDArray[np.uint32],
    colours: NDArray[np.float64],
    view: View,
    size: tuple[int, int],
    line: float = 1.0,
    seam_line: float = 2.2,
) -> Image.Image:
    """A picture of `size` (width, height) pixels.

    `owner`: component of each cell; lines between cells of different owners are drawn as seams.
    `colours`: (m, 3), 0 to 1, of each cell. `line`, `seam_line`: widths in pixels.
    """
    width, height = (SAMPLES * n for n in size)
    axes = view.axes()
    scale = height / view.height
    screen = (np.asarray(vertices) - view.centre) @ axes.T * scale
    screen = np.stack([screen[:, 0] + width / 2, height / 2 - screen[:, 1], screen[:, 2]], axis=1)

    corners, cell, lines = _triangles(cells, owner)
    normals = _corner_normals(vertices, cells, owner) @ axes.T
    visible, hits, bary = _rasterise(screen[corners], width, height)

    # Shade the visible surface, sample by sample.
    corner_normals = normals[corners_index(cells)].astype(np.float32)
    n = sum(bary[k][:, None] * corner_normals[hits, k] for k in range(3))
    n /= np.sqrt(np.einsum("kx,kx->k", n, n))[:, None] + np.float32(1e-30)
    n *= np.where(n[:, 2] < 0, -1, 1).astype(np.float32)[:, None]
    key = np.array([-0.45, 0.65, 0.61], dtype=np.float32)
    half = (key + np.array([0, 0, 1], dtype=np.float32)) / np.linalg.norm(key + [0, 0, 1]).astype(np.float32)
    light = 0.42 + 0.38 * np.clip(n @ key, 0, None) + 0.32 * n[:, 2]
    shine = 0.10 * np.clip(n @ half, 0, None) ** 24
    colour = np.clip(colours.astype(np.float32)[cell[hits]] * light[:, None] + shine[:, None], 0, 1)
    for kind, ink, pixels, strength in ((1, INK, line, 0.62), (2, SEAM_INK, seam_line, 0.95)):
        touched, cover = _line_cover(screen[corners][:, :, :2], lines == kind, hits, bary, pixels * SAMPLES)
        colour[touched] += (np.float32(strength) * cover)[:, None] * (ink.astype(np.float32) - colour[touched])

    down = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None, None]
    sky = np.array([0.90, 0.93, 0.96], dtype=np.float32) * (1 - down) + down
    picture = np.broadcast_to(sky, (height, width, 3)).copy()
    picture.reshape(-1, 3)[visible] = colour
    picture = picture.reshape(size[1], SAMPLES, size[0], SAMPLES, 3).mean(axis=(1, 3))
    return Image.fromarray((picture * 255 + 0.5).astype("u1"))


def corners_index(cells: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Index into (cell, corner), flattened, of the three corners of each triangle of `_triangles`."""
    quads = np.flatnonzero(cells[:, 3] != NO_VERTEX)
    first = np.arange(len(cells))[:, None] * 4 + [0, 1, 2]
    return np.concatenate([first, quads[:, None] * 4 + [0, 2, 3]])


def _triangles(cells: NDArray[np.uint32], owner: NDArray[np.uint32]) -> tuple[NDArray, NDArray, NDArray]:
    """Vertices of the triangles, their cells, and what the edge opposite each corner is: 0 no line, 1 line, 2 seam."""
    index = corners_index(cells)
    cell = index[:, 0] // 4
    corners = cells.reshape(-1)[index].astype(np.int64)
    count = np.where(cells[:, 3] == NO_VERTEX, 3, 4)

    edges, edge_owner = [], []
    for side in range(4):
        has = np.flatnonzero(side < count)
        a, b = cells[has, side], cells[has, (side + 1) % count[has]]
        edges.append(np.minimum(a, b).astype(np.uint64) << np.uint64(32) | np.maximum(a, b))
        edge_owner.append(owner[has])
    edge, edge_owner = np.concatenate(edges), np.concatenate(edge_owner).astype(np.int64)
    names, inverse = np.unique(edge, return_inverse=True)
    low = np.full(len(names), np.iinfo(np.int64).max)
    high = np.full(len(names), -1)
    np.minimum.at(low, inverse, edge_owner)
    np.maximum.at(high, inverse, edge_owner)
    seams = names[low != high]

    lines = np.empty(corners.shape, dtype=int)
    for corner in range(3):
        a, b = corners[:, (corner + 1) % 3], corners[:, (corner + 2) % 3]
        name = np.minimum(a, b).astype(np.uint64) << np.uint64(32) | np.maximum(a, b).astype(np.uint64)
        lines[:, corner] = np.where(np.isin(name, seams), 2, 1)
    quad_first = np.flatnonzero(count == 4)
    lines[quad_first, 1] = 0  # The diagonal 2-0 of the first half,
    lines[len(cells) :, 2] = 0  # and 0-2 of the second.
    return corners, cell, lines


def _corner_normals(vertices: NDArray, cells: NDArray, owner: NDArray) -> NDArray[np.float64]:
    """Unit normals at each corner of each cell, (4 m, 3): the mean over the owner's cells unless there is a crease."""
    safe = np.where(cells == NO_VERTEX, cells[:, :1], cells)
    p = vertices[safe]
    flat = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
    triangle = cells[:, 3] == NO_VERTEX
    flat[triangle] = np.cross(p[triangle, 1] - p[triangle, 0], p[triangle, 2] - p[triangle, 0])
    unit = flat / (np.linalg.norm(flat, axis=1, keepdims=True) + 1e-300)
    key = safe.astype(np.int64) + len(vertices) * owner.astype(np.int64)[:, None]
    names, inverse = np.unique(key.ravel(), return_inverse=True)
    total = np.stack([np.bincount(inverse, np.repeat(flat[:, axis], 4), len(names)) for axis in range(3)], axis=1)
    total /= np.linalg.norm(total, axis=1, keepdims=True) + 1e-300
    smooth, own = total[inverse], np.repeat(unit, 4, axis=0)
    agree = np.einsum("kx,kx->k", smooth, own) > CREASE
    return np.where(agree[:, None], smooth, own)


def _rasterise(triangles: NDArray, width: int, height: int) -> tuple[NDArray, NDArray, tuple]:
    """Samples that show a surface: their index, the triangle seen there, and its three barycentric coordinates."""
    xy, depth = triangles[:, :, :2], triangles[:, :, 2]
    limit = np.array([width, height])
    low = np.clip(np.ceil(xy.min(axis=1) - 0.5), 0, limit).astype(np.int64)
    high = np.clip(np.floor(xy.max(axis=1) - 0.5) + 1, 0, limit).astype(np.int64)
    extent = np.maximum(high - low, 0)
    a, b, c = xy[:, 0], xy[:, 1], xy[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    sizes = extent[:, 0] * extent[:, 1]
    # Meshes are closed: back faces are hidden (y points down here, so areas towards the eye are negative).
    order = np.flatnonzero((sizes > 0) & (area < -1e-9))
    nearest = np.full(width * height, -np.inf, dtype=np.float32)
    seen_in = np.zeros(width * height, dtype=np.int32)
    # Data of a triangle for its samples: barycentric coordinates and depth are affine on the screen.
    gradient = np.stack([c[:, 1] - a[:, 1], a[:, 0] - c[:, 0], a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]], axis=1)
    gradient /= np.where(area == 0, 1, area)[:, None]
    ends = np.cumsum(sizes[order])
    start = 0
    while start < len(order):
        base = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, base + BATCH)))
        chosen = order[start:stop]
        start = stop
        t = np.repeat(chosen.astype(np.int32), sizes[chosen])
        local = np.arange(len(t), dtype=np.int32)
        local -= np.repeat((np.cumsum(sizes[chosen]) - sizes[chosen]).astype(np.int32), sizes[chosen])
        row, column = np.divmod(local, extent[:, 0].astype(np.int32)[t])
        l1, l2 = _barycentric(t, column, row, low + 0.5 - a, gradient)
        inside = np.flatnonzero((l1 >= -1e-5) & (l2 >= -1e-5) & (l1 + l2 <= 1 + 1e-5))
        t, l1, l2 = t[inside], l1[inside], l2[inside]
        pixel = (low[t, 1] + row[inside]) * width + low[t, 0] + column[inside]
        z = (depth[t, 0] + l1 * (depth[t, 1] - depth[t, 0]) + l2 * (depth[t, 2] - depth[t, 0])).astype(np.float32)
        np.maximum.at(nearest, pixel, z)
        front = z == nearest[pixel]
        seen_in[pixel[front]] = t[front]
    visible = np.flatnonzero(nearest > -np.inf)
    t = seen_in[visible]
    row, column = np.divmod(visible, width)
    l1, l2 = _barycentric(t, column, row, 0.5 - a, gradient)
    return visible, t, (1 - l1 - l2, l1, l2)


def _barycentric(t: NDArray, x: NDArray, y: NDArray, offset: NDArray, gradient: NDArray) -> tuple[NDArray, NDArray]:
    """Barycentric coordinates 1 and 2 in triangles `t` of the samples at `x`, `y` beyond their `offset` from corner 0."""
    offset, gradient = offset.astype(np.float32), gradient.astype(np.float32)
    dx, dy = x + offset[t, 0], y + offset[t, 1]
    return dx * gradient[t, 0] + dy * gradient[t, 1], dx * gradient[t, 2] + dy * gradient[t, 3]


def _line_cover(xy: NDArray, drawn: NDArray, hits: NDArray, bary: tuple, width: float) -> tuple[NDArray, NDArray]:
    """Samples that lines touch, and how much, 0 to 1; lines of cells too small for them fade."""
    a, b, c = xy[:, 0], xy[:, 1], xy[:, 2]
    area = np.abs((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    cover = np.zeros(len(hits), dtype=np.float32)
    for corner in range(3):
        if width == 0 or not drawn[:, corner].any():
            continue
        edge = xy[:, (corner + 2) % 3] - xy[:, (corner + 1) % 3]
        heights = area / (np.linalg.norm(edge, axis=1) + 1e-300)
        fade = np.where(drawn[:, corner], np.clip(heights / (5 * width), 0, 1), 0).astype(np.float32)
        distance = bary[corner] * heights.astype(np.float32)[hits]
        near = np.flatnonzero(distance < width / 2 + 0.5)
        inked = np.clip(width / 2 + 0.5 - distance[near], 0, 1) * fade[hits[near]]
        cover[near] = np.maximum(cover[near], inked)
    touched = np.flatnonzero(cover)
    return touched, cover[touched]


# Light blue over yellow to red.
_RAMP = np.array([[0.80, 0.87, 0.92], [0.45, 0.68, 0.82], [0.99, 0.85, 0.45], [0.95, 0.50, 0.25], [0.70, 0.10, 0.18]])


def ramp(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """Colours (k, 3) of values: light blue at `low`, red at `high` and beyond."""
    t = np.clip((np.asarray(values) - low) / (high - low), 0, 1)
    at = np.linspace(0, 1, len(_RAMP))
    return np.stack([np.interp(t, at, _RAMP[:, k]) for k in range(3)], axis=-1)


def text(image: Image.Image, position: tuple[int, int], words: str, size: int = 26, colour: str = "#1c222c") -> None:
    """Writes on a picture; `position` is the text's left upper corner."""
    font = ImageFont.load_default(size)
    # A light rim keeps the words readable over the mesh.
    ImageDraw.Draw(image).text(position, words, fill=colour, font=font, stroke_width=3, stroke_fill="#f4f7fa")


def colour_bar(image: Image.Image, low: float, high: float, title: str) -> None:
    """Draws the scale of `ramp` into the right lower corner."""
    width, height = 300, 16
    x, y = image.width - width - 40, image.height - 62
    bar = np.broadcast_to(ramp(np.linspace(low, high, width), low, high), (height, width, 3))
    image.paste(Image.fromarray((bar * 255).astype("u1")), (x, y))
    text(image, (x, y - 30), title, 20)
    for k in range(5):
        value = low + k / 4 * (high - low)
        text(image, (x + k * width // 4 - 10, y + height + 6), f"{value:g}{'+' if k == 4 else ''}", 18)


def beside(images: list[Image.Image], columns: int) -> Image.Image:
    """Pictures of one size in rows."""
    gap = 6
    width, height = images[0].size
    rows = -(-len(images) // columns)
    size = (columns * (width + gap) - gap, rows * (height + gap) - gap)
    sheet = Image.new("RGB", size, "white")
    for k, image in enumerate(images):
        sheet.paste(image, (k % columns * (width + gap), k // columns * (height + gap)))
    return sheet
