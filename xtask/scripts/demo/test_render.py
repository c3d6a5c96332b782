"""The renderer against pictures that are known in closed form."""

import numpy as np
import pytest

from render import NO_VERTEX, View, ramp, render

FRONT = View(centre=(0, 0, 0), towards=(0, -1, 0), height=4.0)
SIZE = (200, 100)


def squares(*ys: float) -> tuple[np.ndarray, np.ndarray]:
    """Squares of 0.96 m about the y axis at the given y, facing -y."""
    corners = 0.48 * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    vertices = np.concatenate([corners + [0, y, 0] for y in ys])
    return vertices, np.arange(4 * len(ys), dtype=np.uint32).reshape(-1, 4)


def drawn(vertices: np.ndarray, cells: np.ndarray, colours: list, **lines: float) -> np.ndarray:
    owner = np.zeros(len(cells), dtype=np.uint32)
    image = render(vertices, cells, owner, np.array(colours, float), FRONT, SIZE, **lines)
    return np.asarray(image).astype(int)


def is_red(picture: np.ndarray) -> np.ndarray:
    return picture[..., 0] > picture[..., 2] + 60


@pytest.mark.parametrize("triangles", [False, True])
def test_a_square_covers_its_pixels(triangles: bool) -> None:
    vertices, cells = squares(0)
    if triangles:
        cells = np.array([[0, 1, 2, NO_VERTEX], [0, 2, 3, NO_VERTEX]], dtype=np.uint32)
    red = is_red(drawn(vertices, cells, [[1, 0, 0]] * len(cells), line=0, seam_line=0))
    rows, columns = np.nonzero(red)
    # 25 pixels a metre about the middle of the picture.
    assert red.sum() == 24 * 24
    assert (columns.min(), columns.max()) == (88, 111)
    assert (rows.min(), rows.max()) == (38, 61)


@pytest.mark.parametrize("order", [(-1.0, 1.0), (1.0, -1.0)])
def test_the_nearer_surface_is_seen(order: tuple[float, float]) -> None:
    vertices, cells = squares(*order)
    colours = [[1, 0, 0] if y < 0 else [0, 0, 1] for y in order]
    picture = drawn(vertices, cells, colours)
    assert is_red(picture)[50, 100]


def test_what_is_turned_away_is_not_drawn() -> None:
    vertices, cells = squares(0)
    assert not is_red(drawn(vertices, cells[:, ::-1], [[1, 0, 0]])).any()


def test_lines_are_drawn_along_edges_but_not_across_quadrilaterals() -> None:
    vertices, cells = squares(0)
    plain = drawn(vertices, cells, [[1, 1, 1]], line=0)
    lined = drawn(vertices, cells, [[1, 1, 1]], line=2)
    darker = plain.sum(axis=2) - lined.sum(axis=2) > 60
    assert darker[50, 88:90].any() and darker[50, 110:113].any()
    assert not darker[42:58, 92:108].any()


def test_the_colour_scale_keeps_to_its_ends() -> None:
    ends = ramp(np.array([-10.0, 0.0, 1.0, 10.0]), 0.0, 1.0)
    assert (ends[0] == ends[1]).all() and (ends[2] == ends[3]).all() and (ends[1] != ends[2]).any()
