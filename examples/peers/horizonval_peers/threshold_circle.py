"""The floor: a threshold, the longest border, and the circle on the sphere of directions that most of it lies on.

What a day's work with OpenCV gives. A sphere's limb is a circle among directions whatever the camera makes of it in the
image, so three directions make a circle, and the one of 200 that most others lie on to a pixel is fitted once more to
those. It claims no uncertainty.

``otsu-circle``
    Otsu's threshold, the one that everybody takes. It lies between two levels, and where a lens darkens its corners the
    dark corners of the Earth are on the sky's side of it.
``triangle-circle``
    OpenCV's other automatic threshold, just above the level that most pixels have: the sky's, where most is sky. It was
    added when Otsu's was seen to follow the lens and not the limb.
"""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np

import horizonval as hv
from horizonval_peers.canny import lines_of_sight
from horizonval_peers.picture import fit_of, grey_8bit

TRIALS = 200
FEWEST = 20


def run(observation: hv.Observation, threshold: int) -> hv.Fit | hv.Refusal:
    """Return the nadir from the border of what is brighter than the threshold of a kind of OpenCV's."""
    grey = grey_8bit(observation)
    bright = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + threshold)[1]
    borders = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    points = max(borders, key=len, default=np.empty((0, 1, 2))).reshape(-1, 2).astype(np.float64)
    points = points[(points > 0).all(axis=1) & (points < np.array(grey.shape[::-1]) - 1).all(axis=1)]
    if len(points) < FEWEST:
        return hv.Refusal(hv.Outcome.NO_LIMB, f"the longest border has {len(points)} pixels inside the image", points)
    rays = lines_of_sight(observation, points)
    threes = rays[np.random.default_rng(0).integers(len(rays), size=(TRIALS, 3))]
    normals = np.cross(threes[:, 1] - threes[:, 0], threes[:, 2] - threes[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    on_it = np.abs(normals @ rays.T - (normals * threes[:, 0]).sum(axis=1)[:, None]) < 1.0 / observation.camera.fx
    best = rays[on_it[on_it.sum(axis=1).argmax()]]
    m = np.linalg.lstsq(best, np.ones(len(best)), rcond=None)[0]
    if len(best) < max(FEWEST, len(rays) / 2) or not np.linalg.norm(m) > 1.0:
        return hv.Refusal(hv.Outcome.NO_LIMB, "the border is no circle", points)
    return fit_of(observation, m, points, rho_rad=float(np.arccos(1.0 / np.linalg.norm(m))))


OTSU = hv.Estimator(
    "otsu-circle", "Otsu's threshold and a robust circle, by OpenCV", partial(run, threshold=cv2.THRESH_OTSU)
)
TRIANGLE = hv.Estimator(
    "triangle-circle",
    "The triangle threshold and a robust circle, by OpenCV",
    partial(run, threshold=cv2.THRESH_TRIANGLE),
)
