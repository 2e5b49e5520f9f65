"""The lens as a whole: energy to the last millionth, and each stage switched off alone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel
from horizonval.sensor.lens import image_plane, lens_spread, scatter
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics

CAMERA = CameraModel(width=200, height=160, fx=170.0, fy=175.0, cx=99.5, cy=79.5)
BAND = Band(name="vis", kind="solar", lo_um=0.45, hi_um=0.75)
PITCH = 5.5e-6

WINGS = {"tis": 0.02, "l_rad": 0.01, "s": -1.8}
LENSES: dict[str, dict[str, Any]] = {
    "gaussian": {"psf_sigma_px": 0.7},
    "field": {"psf_field_deg": [0, 30], "psf_field_sigma_px": [0.6, 1.5]},
    "diffraction": {"diffraction": True},
    "defocus": {"defocus_um": 40.0, "psf_sigma_px": 0.5},
    "scatter": {"psf_sigma_px": 0.7, "scatter": WINGS},
    "all": {
        "psf_field_deg": [0, 30],
        "psf_field_sigma_px": [0.6, 1.5],
        "diffraction": True,
        "defocus_um": -20.0,
        "scatter": WINGS,
    },
}


def lens_of(name: str) -> Optics:
    return Optics.model_validate({"f_number": 4.0, **LENSES[name]})


def scene(sun: float = 1e9) -> np.ndarray:
    """Return space, Earth about 1, and the Sun of 12 pixels, a part of it on the border."""
    image = np.zeros((160, 200))
    image[90:] = 1 + np.random.default_rng(1).random((70, 200))
    image[40:43, 60:63] = sun
    image[0, 120:123] = sun
    return image


@pytest.mark.parametrize("name", LENSES)
def test_energy_is_kept_but_for_what_leaves(name):
    """Bar: 1e-6, with a Sun of 1e9, nothing below 0."""
    image, lens = scene(), lens_of(name)
    spread = lens_spread.spread(image, CAMERA, lens, BAND, PITCH, "dark")
    lost = lens_spread.lost_share(CAMERA, lens, BAND, PITCH)
    assert spread.min() >= 0
    assert lost.min() > -1e-12
    assert spread.sum() + (lost * image).sum() == pytest.approx(image.sum(), rel=1e-9)
    # And of the faint Earth alone.
    earth = scene(0.0)
    spread = lens_spread.spread(earth, CAMERA, lens, BAND, PITCH, "dark")
    assert spread.sum() + (lost * earth).sum() == pytest.approx(earth.sum(), rel=1e-9)


def test_what_leaves_is_what_the_formulas_say():
    """From the middle pixel the core stays; the wings beyond the border are integrals in closed form."""
    camera = CameraModel(width=201, height=161, fx=170.0, fy=175.0, cx=100.0, cy=80.0)
    lost = lens_spread.lost_share(camera, lens_of("scatter"), BAND, PITCH)[80, 100]
    given = lens_of("scatter").scatter
    inside = scatter.share_in_rectangle(given, 100.5 / 170, 80.5 / 175)
    # Pixels are taken by their centres far from the point: 1e-6 of all light.
    assert lost == pytest.approx(0.02 - inside, abs=1e-6)
    lost = lens_spread.lost_share(camera, lens_of("diffraction"), BAND, PITCH)[80, 100]
    spread = 0.6125e-6 * 4 / PITCH  # Photon-weighted mean wavelength of 0.45 to 0.75 um.
    exact = spread / math.pi**3 * 4 * (80.5 / 100.5 + 100.5 / 80.5) / math.hypot(80.5, 100.5)
    assert lost == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_an_even_scene_stays_even_to_the_corners(name):
    """What is outside is guessed to be the same: uniform sources calibrate a camera whatever its wings."""
    even = lens_spread.spread(np.full((160, 200), 3.0), CAMERA, lens_of(name), BAND, PITCH)
    # Unequal Gaussians: what goes out of a pixel and what comes in differ by half the curvature of the variance.
    np.testing.assert_allclose(even, 3.0, rtol=8e-3 if name in ("field", "all") else 1e-9)
    assert even.mean() == pytest.approx(3.0, rel=1e-3)


def test_off_stages_leave_no_trace():
    """The image of a lens with every new stage written out as off is that of the short file, byte for byte."""
    radiance = scene(1e4)
    short = image_plane.pixel_power_w(radiance, CAMERA, Optics(psf_sigma_px=0.7), PITCH)
    written = Optics.model_validate(
        {"psf_sigma_px": 0.7, "vignetting": [], "diffraction": False, "defocus_um": 0.0, "ghost": []}
    )
    assert image_plane.pixel_power_w(radiance, CAMERA, written, PITCH, BAND).tobytes() == short.tobytes()
    assert written.model_dump() == {"f_number": 2.8, "transmission": 1.0, "psf_sigma_px": 0.7}


ABLATIONS: dict[str, Any] = {
    "vignetting": {"vignetting_deg": [0, 20], "vignetting": [1.0, 0.5]},
    "pupil": {"pupil": "constant"},
    "ghost": {"ghost": [{"ratio": 0.05, "scale": -1.0}]},
    "scatter": {"scatter": WINGS},
    "defocus": {"defocus_um": 40.0},
    "diffraction": {"diffraction": True},
}


def test_diffraction_needs_the_band_and_the_pitch():
    with pytest.raises(UserError, match="diffraction"):
        image_plane.radiance_on_axis(scene(), CAMERA, Optics(diffraction=True))
