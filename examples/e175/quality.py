"""Cell quality in numpy. Cells are [cell, 4]; a triangle repeats its third vertex."""

import numpy as np


def is_triangle(cells):
    return cells[:, 2] == cells[:, 3]


def edges(vertices, cells):
    """Edge vectors [cell, 4, 3], from corner k to corner k + 1; a triangle's third one is zero."""
    corners = vertices[cells]
    return np.roll(corners, -1, axis=1) - corners


def area_normal(vertices, cells):
    """Newell normal of each cell, its length the area."""
    corners = vertices[cells]
    return 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])


def aspect_ratio(vertices, cells):
    """Verdict's aspect ratio, as VTK computes it: longest edge times perimeter over 4 times the area (quadrilateral)
    or 4 sqrt(3) times (triangle)."""
    e = edges(vertices, cells)
    length = np.linalg.norm(e, axis=2)
    triangle = is_triangle(cells)
    cross = lambda a, b: np.linalg.norm(np.cross(a, b), axis=1)
    quad_area = 0.5 * (cross(e[:, 0], e[:, 1]) + cross(e[:, 2], e[:, 3]))
    area = np.where(triangle, np.sqrt(3) * 0.5 * cross(e[:, 0], e[:, 1]), quad_area)
    return length.max(1) * length.sum(1) / (4 * area)


def edge_ratio(vertices, cells):
    """Longest over shortest edge."""
    length = np.linalg.norm(edges(vertices, cells), axis=2)
    length[is_triangle(cells), 2] = length[is_triangle(cells), 0]
    return length.max(1) / length.min(1)


def corner_angles(vertices, cells):
    """Corner angles in degrees, [cell, 4]; a triangle's fourth is NaN."""
    e = edges(vertices, cells)
    triangle = is_triangle(cells)
    e[triangle, 2] = e[triangle, 3]
    before = -np.roll(e, 1, axis=1)
    before[triangle, 0] = -e[triangle, 3]
    cosine = (e * before).sum(2) / np.linalg.norm(e, axis=2) / np.linalg.norm(before, axis=2)
    angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    angles[triangle, 3] = np.nan
    return angles


def summary(vertices, cells):
    """Statistics of a set of cells for the report."""
    aspect, ratio = aspect_ratio(vertices, cells), edge_ratio(vertices, cells)
    angles = corner_angles(vertices, cells)
    spread = lambda x: {f"p{p}": float(np.percentile(x, p)) for p in (50, 95, 99)} | {"max": float(x.max())}
    return {
        "cells": len(cells),
        "triangles": int(is_triangle(cells).sum()),
        "aspect_ratio": spread(aspect) | {"above_5": int((aspect > 5).sum())},
        "edge_ratio": spread(ratio),
        "angle_min": float(np.nanmin(angles)),
        "angle_max": float(np.nanmax(angles)),
    }
