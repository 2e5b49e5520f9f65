"""Edges by OpenCV's Canny, and their lines of sight by OpenCV's camera.

Blur, thresholds and norm are those that Basilisk's limb finding ships with, so that rows differ by the fit alone. Every
edge counts, of a cloud or a coast as much as of the limb: nothing here knows which is which.
"""

from __future__ import annotations

import cv2
import numpy as np

import horizonval as hv
from horizonval.geometry.camera import unproject
from horizonval_peers.picture import grey_8bit

FEWEST = 50
"""Of edge pixels, Basilisk's own number."""


def edges(observation: hv.Observation) -> np.ndarray:
    """Return the edge pixels, (column, row), shape (n, 2); empty where there are no more than a few."""
    blurred = cv2.GaussianBlur(grey_8bit(observation), (3, 3), 1)
    found = cv2.findNonZero(cv2.Canny(blurred, 100, 200, apertureSize=3, L2gradient=True))
    points = np.empty((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
    return points if len(points) > FEWEST else points[:0]


def lines_of_sight(observation: hv.Observation, points: np.ndarray) -> np.ndarray:
    """Return the unit lines of sight to pixels, shape (n, 3); pixel (0, 0) is a centre here as in OpenCV."""
    camera = observation.camera
    if camera.projection != "pinhole" or camera.skew:
        return unproject(camera, points)
    matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    plane = cv2.undistortPoints(points.reshape(-1, 1, 2), matrix, np.array(camera.distortion)).reshape(-1, 2)
    rays = np.column_stack([plane, np.ones(len(plane))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def no_edges() -> hv.Refusal:
    """Return what an image without edges gets."""
    return hv.Refusal(hv.Outcome.NO_LIMB, f"no more than {FEWEST} edge pixels")
