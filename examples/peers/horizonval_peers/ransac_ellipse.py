"""Scikit-image's robust ellipse through a sub-pixel contour, and the cone that the ellipse is the image of.

An ellipse ``x . C x = 0`` in the plane at distance 1 is a section of the cone of lines of sight to the limb. Of a
sphere that cone is circular, and its axis the eigenvector of the one eigenvalue of ``C`` whose sign differs. Close to
the Earth the section of the limb is a hyperbola, which no ellipse is: there the model is wrong by construction.

The contour is ``skimage.measure.find_contours``'s, the fit ``ransac`` of ``EllipseModel``, both with their own defaults
but for the distance within which a point belongs to the ellipse, a pixel. The threshold is the triangle's for the
reason given in :mod:`horizonval_peers.threshold_circle`. No uncertainty is claimed.
"""

from __future__ import annotations

import numpy as np
from skimage.filters import threshold_triangle
from skimage.measure import EllipseModel, find_contours, ransac

import horizonval as hv
from horizonval_peers.canny import lines_of_sight
from horizonval_peers.picture import fit_of, grey_8bit

FEWEST, TRIALS = 20, 200
MOST = 400
"""Points of the contour that are fitted, evenly along it: the distance of a point from an ellipse is a search of its
own in scikit-image, and every trial asks for all of them."""


def run(observation: hv.Observation) -> hv.Fit | hv.Refusal:
    """Return the axis of the cone through the ellipse that most of the longest contour lies on."""
    grey = grey_8bit(observation)
    if grey.min() == grey.max():
        return hv.Refusal(hv.Outcome.NO_LIMB, "all pixels are alike")
    contours = find_contours(grey.astype(np.float64), float(threshold_triangle(grey)))
    points = max(contours, key=len, default=np.empty((0, 2)))[:, ::-1]
    points = points[:: max(1, -(-len(points) // MOST))]
    if len(points) < FEWEST:
        return hv.Refusal(hv.Outcome.NO_LIMB, f"the longest contour has {len(points)} points", points)
    # The lens is taken out first; what remains is the plane at distance 1, in pixels.
    rays = lines_of_sight(observation, points)
    camera = observation.camera
    plane = rays[:, :2] / rays[:, 2:] * camera.fx
    model, inliers = ransac(
        plane, EllipseModel, min_samples=5, residual_threshold=1.0, max_trials=TRIALS, rng=np.random.default_rng(0)
    )
    if not model or inliers is None or inliers.sum() < max(FEWEST, len(points) / 2):
        return hv.Refusal(hv.Outcome.NO_LIMB, "the contour is no ellipse", points)
    cone = _cone_of(np.asarray(model.center) / camera.fx, np.asarray(model.axis_lengths) / camera.fx, model.theta)
    return fit_of(observation, _axis(cone), points[inliers])


def _cone_of(centre: np.ndarray, axes: np.ndarray, theta: float) -> np.ndarray:
    """Return ``C`` of an ellipse in the plane at distance 1."""
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    quadratic = turn.T @ np.diag(axes**-2.0) @ turn
    linear = -quadratic @ centre
    return np.block([[quadratic, linear[:, None]], [linear[None, :], centre @ quadratic @ centre - 1.0]])


def _axis(cone: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(cone)
    # Two are positive and one is negative, the smallest: its eigenvector lies within the cone.
    axis = vectors[:, values.argmin()]
    return axis if axis[2] > 0.0 else -axis


ESTIMATOR = hv.Estimator("scikit-image-ellipse", "Robust ellipse of scikit-image", run)
