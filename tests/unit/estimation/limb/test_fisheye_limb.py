"""The limb in fisheye images: found behind the camera plane too, and told from the edge of the lens's own field."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.proposals import LimbPoints
from horizonval.geometry.camera import CameraModel, in_image_circle, pixel_grid, unproject
from horizonval.geometry.horizon import fit_cone

RHO = math.radians(68.0)


def fisheye(circle_deg: float) -> CameraModel:
    return CameraModel(
        240, 240, 72.0, 72.0, 119.5, 119.5, (0.01, -0.002, 0.0, 0.0, 0.0), "fisheye", math.radians(circle_deg) / 2
    )


def picture(camera: CameraModel, nadir: Any) -> Any:
    """A bright disc of angular radius RHO about the nadir on black, its edge one pixel (0.8 deg) wide."""
    d = unproject(camera, pixel_grid(camera))
    off = np.arctan2(np.linalg.norm(np.cross(d, nadir), axis=-1), d @ nadir)
    grey = 1000.0 * np.clip(0.5 + (RHO - off) * 72.0, 0.0, 1.0)
    return np.where(in_image_circle(camera), grey, 0.0)


@pytest.mark.parametrize("tilt_deg", [0.0, 40.0, 110.0])
def test_the_nadir_from_a_190_deg_fisheye(tilt_deg: float) -> None:
    """0.08 deg, a tenth of a pixel: the edge is linear in angle and not in the image, and there is no noise.

    At 110 deg the nadir is behind the camera, and so are limb points at the circle.
    """
    tilt = math.radians(tilt_deg)
    nadir = np.array([0.0, math.sin(tilt), math.cos(tilt)])
    camera = fisheye(190.0)
    found = find_limb(picture(camera, nadir), camera, 1023.0)
    assert isinstance(found, LimbPoints)
    cone = fit_cone(found.los_cam)
    assert math.degrees(math.acos(min(1.0, float(cone.axis_cam @ nadir)))) < 0.08
    assert math.degrees(abs(cone.rho_rad - RHO)) < 0.08


def test_the_edge_of_the_field_is_no_limb() -> None:
    """A lens of 120 deg that looks down sees ground alone: a bright disc with black around it, all of it its own."""
    camera = fisheye(120.0)
    found = find_limb(picture(camera, np.array([0.0, 0.0, 1.0])), camera, 1023.0)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.NO_LIMB


def test_a_line_of_pixels_is_refused_as_an_image() -> None:
    camera = CameraModel(160, 1, 569.0, 569.0, 79.5, 0.0)
    found = find_limb(np.linspace(0.0, 100.0, 160)[None, :], camera)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT
