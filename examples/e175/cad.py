"""B-spline patches as surfaces of gmsh's OpenCASCADE kernel."""

import numpy as np


def occ_surface(occ, patch):
    """Adds the patch to the OpenCASCADE model `occ` (gmsh.model.occ); returns its tag."""
    net = patch.control_points
    points = [occ.addPoint(*net[i, j]) for j in range(net.shape[1]) for i in range(net.shape[0])]
    knots_u, times_u = np.unique(patch.knots_u, return_counts=True)
    knots_v, times_v = np.unique(patch.knots_v, return_counts=True)
    weights = [] if patch.weights is None else np.asarray(patch.weights).T.ravel().tolist()
    surface = occ.addBSplineSurface(
        points,
        net.shape[0],
        degreeU=patch.degree_u,
        degreeV=patch.degree_v,
        weights=weights,
        knotsU=knots_u.tolist(),
        knotsV=knots_v.tolist(),
        multiplicitiesU=times_u.tolist(),
        multiplicitiesV=times_v.tolist(),
    )
    occ.remove([(0, p) for p in points])
    return surface
