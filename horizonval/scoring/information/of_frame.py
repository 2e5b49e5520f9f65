"""The information of a rendered frame as a camera sees it, and images that carry it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.earth.limb_relief import SOLAR_RELIEF, THERMAL_RELIEF
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.scoring.information.information import KEY, LimbInformation
from horizonval.scoring.information.limb_information import limb_information
from horizonval.sensor.expected_image import expected_image
from horizonval.spec.camera import CameraSpec


def information_of(frame: RadianceFrame, camera: CameraSpec, band: str | None = None) -> LimbInformation | None:
    """Return what one band of a frame says about the pose, seen by a camera; None without limb in it.

    Parameters
    ----------
    frame : RadianceFrame
        Radiance without noise.
    camera : CameraSpec
        As for :func:`horizonval.sensor.observe.observe`.
    band : str, optional
    """
    truth = frame.truth
    kinds = {one.name: one.kind for one in camera.band}
    solar = kinds[band or camera.band[0].name] == "solar"
    return limb_information(
        expected_image(frame, camera, band),
        truth.camera_model,
        Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(),
        np.array(truth.r_itrs),
        truth.ellipsoid,
        SOLAR_RELIEF if solar else THERMAL_RELIEF,
        body_from_cam=Rotation.from_quat(truth.q_cam_from_body).inv().as_matrix(),
    )


def informed(image: DetectorImage, frame: RadianceFrame) -> DetectorImage:
    """Return an image that carries the information of its frame, so that it can be scored without."""
    camera = CameraSpec.model_validate(image.observation.get("camera", image.truth.camera))
    found = information_of(frame, camera, image.band)
    return replace(image, observation={**image.observation, KEY: None if found is None else found.to_dict()})
