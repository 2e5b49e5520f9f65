"""Basilisk's limb finding and horizon navigation (AVS Lab, ISC licence), as ``pip install "bsk[opnav]"`` brings them.

``limbFinding`` reads a picture of 8 bits and writes every Canny edge as a limb point, whole pixels in raster order;
``horizonOpNav`` is Christian and Robinson's fit to them with a covariance. Both are called as their own unit tests call
them, module by module, without a simulation. What they want is given to them:

- the picture as a file of 8 bits;
- the camera as a field of view and a size. The field of view is the vertical one. They know no lens: points are moved
  from where the lens put them to where a pinhole would, and a principal point off the centre cannot be told;
- the planet by number. 1 is the Earth, oblate about the axis of the inertial frame, for which they want an attitude:
  it is handed over where the prior has one. Of a sphere, or without an attitude, 3 is Jupiter, which they take for a
  sphere; a nadir does not depend on its radius. No radius can be given;
- ``noiseSF`` as in their unit test. The noise of a pixel is then taken for ``noiseSF * width / points``.

Three estimators differ in what is done to the points between the two modules:

``basilisk``
    nothing: the chain as it is sold.
``basilisk-half-pixel``
    half a pixel is added. The camera's centre is ``resolution / 2`` there, that of pixels counted from the corner of
    the first, and the points are whole pixels counted from its middle.
``basilisk-mended``
    columns are scaled too. The horizontal scale is that of the angle ``fieldOfView * width / height``, where the
    tangent of half of it scales: 4 % in an image of 160 x 120 pixels and 57 deg, nothing in a square one.

Each image gets new modules, as every image gets a new process. A chain that runs on takes the second image for Mars:
``limbFinding`` writes planet 2 into its message, and ``horizonOpNav`` keeps that for the next.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval_peers.canny import lines_of_sight
from horizonval_peers.picture import fit_of, grey_8bit

try:
    from Basilisk.architecture import messaging
    from Basilisk.fswAlgorithms import horizonOpNav, limbFinding
except ImportError as e:
    raise ImportError('Basilisk with its image modules is missing: pip install "bsk[opnav]"') from e

NOISE_SCALE = 2.0
EARTH, JUPITER = 1, 3
WGS84_FLATTENED = "wgs84"


@dataclass(frozen=True)
class Mend:
    """What is done to the limb points between the modules."""

    half_pixel: bool = False
    aspect: bool = False


def run(observation: hv.Observation, mend: Mend) -> hv.Fit | hv.Refusal:
    """Return what the chain makes of an image."""
    points = limb_points(grey_8bit(observation))
    if len(points) == 0:
        return hv.Refusal(hv.Outcome.NO_LIMB, "limbFinding: no valid limb")
    position, covariance = position_m(observation, _as_pinhole(observation, points), mend)
    distance = float(np.linalg.norm(position))
    if not np.isfinite(distance) or distance == 0.0:
        return hv.Refusal(hv.Outcome.NOT_CONVERGED, "horizonOpNav: the position is not finite", points)
    nadir = -position / distance
    across = (np.eye(3) - np.outer(nadir, nadir)) / distance
    return fit_of(observation, nadir, points, across @ covariance @ across)


def limb_points(grey: np.ndarray) -> np.ndarray:
    """Return the points that ``limbFinding`` writes, (column, row), shape (n, 2); none where it finds none valid."""
    module = limbFinding.LimbFinding()
    nothing = messaging.CameraImageMsg().write(messaging.CameraImageMsgPayload())
    module.imageInMsg.subscribeTo(nothing)
    with tempfile.TemporaryDirectory() as folder:
        module.filename = str(Path(folder) / "image.png")
        cv2.imwrite(module.filename, grey)
        module.Reset(0)
        module.UpdateState(0)
    found = module.opnavLimbOutMsg.read()
    count = int(found.numLimbPoints) if found.valid else 0
    return np.array(found.limbPoints[: 2 * count], dtype=np.float64).reshape(-1, 2)


def position_m(observation: hv.Observation, points: np.ndarray, mend: Mend = Mend()) -> tuple[np.ndarray, np.ndarray]:
    """Return the position from the planet's centre in camera axes and its covariance, as ``horizonOpNav`` has them."""
    camera = observation.camera
    field_rad = 2.0 * np.arctan(camera.height / 2.0 / camera.fy)
    fed = points + 0.5 if mend.half_pixel else points.copy()
    if mend.aspect:
        theirs = camera.width / 2.0 / np.tan(field_rad * camera.width / camera.height / 2.0)
        fed[:, 0] = (fed[:, 0] - camera.width // 2) * theirs / camera.fx + camera.width // 2
    attitude = observation.prior.q_cam_from_itrs
    earth = observation.prior.shape == WGS84_FLATTENED and attitude is not None

    limb = messaging.OpNavLimbMsgPayload()
    limb.valid, limb.planetIds, limb.numLimbPoints = 1, EARTH if earth else JUPITER, len(fed)
    limb.limbPoints = [*fed.ravel().tolist(), *[0.0] * (len(limb.limbPoints) - fed.size)]
    optics = messaging.CameraConfigMsgPayload()
    optics.fieldOfView, optics.resolution = field_rad, [camera.width, camera.height]
    pose = messaging.NavAttMsgPayload()
    if earth and attitude is not None:
        # Their matrix takes a vector's components from inertial to body axes: the turn of the axes, not of the vector.
        pose.sigma_BN = Rotation.from_quat(attitude).inv().as_mrp().tolist()

    module = horizonOpNav.horizonOpNav()
    module.planetTarget, module.noiseSF = EARTH if earth else JUPITER, NOISE_SCALE
    messages = messaging.OpNavLimbMsg().write(limb), messaging.CameraConfigMsg().write(optics)
    attitude_message = messaging.NavAttMsg().write(pose)
    module.limbInMsg.subscribeTo(messages[0])
    module.cameraConfigInMsg.subscribeTo(messages[1])
    module.attInMsg.subscribeTo(attitude_message)
    module.SelfInit()
    module.Reset(0)
    module.UpdateState(0)
    found = module.opNavOutMsg.read()
    return np.array(found.r_BN_C).ravel(), np.array(found.covar_C).reshape(3, 3)


def _as_pinhole(observation: hv.Observation, points: np.ndarray) -> np.ndarray:
    """Return where points would be without distortion and with a principal point in the image's middle."""
    camera = observation.camera
    plain = camera.projection == "pinhole" and not any(camera.distortion) and not camera.skew
    if plain and camera.cx == (camera.width - 1) / 2 and camera.cy == (camera.height - 1) / 2:
        return points
    rays = lines_of_sight(observation, points)
    plane = rays[:, :2] / rays[:, 2:] * [camera.fx, camera.fy]
    return plane + np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])


STOCK = hv.Estimator("basilisk", "Basilisk, limbFinding and horizonOpNav", partial(run, mend=Mend()))
HALF_PIXEL = hv.Estimator(
    "basilisk-half-pixel", "Basilisk, half a pixel added between the modules", partial(run, mend=Mend(half_pixel=True))
)
MENDED = hv.Estimator(
    "basilisk-mended",
    "Basilisk, half a pixel and the horizontal scale put right between the modules",
    partial(run, mend=Mend(half_pixel=True, aspect=True)),
)
