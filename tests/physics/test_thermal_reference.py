"""Thermal bands by Monte Carlo against closed form, and deterministic frames against the Monte Carlo.

The Monte Carlo walks paths backward to where their light was emitted and takes the mean; the march integrates. Both
read the same absorption, temperatures and emissivities. The bar is three standard errors of every group of pixels;
0.1 % is added for what is known to differ: tables of the deterministic frame (1e-3 at worst, 1e-5 mostly), and a sky
over reflecting ground that is computed in plane layers (0.05 % of a band).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.constants import c, h, k
from scipy.integrate import quad

import horizonval as hv
from horizonval.frame import Hit, RadianceFrame
from horizonval.renderer.frame import render_frame
from horizonval.renderer.reference.reference import MOST_SUBSAMPLES, render_reference, resized
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

KNOWN = 1e-3


def _scene(roll_deg: float = 68.0, **tables: Any) -> tuple[SceneSpec, CameraSpec]:
    """Return 20 x 16 pixels of a limb or the ground in the window and in the carbon dioxide band, straight rays."""
    bands = [("window", 10.5, 12.5), ("co2", 14.0, 16.3)]
    scene = {
        "camera": {"file": "test", "mount_roll_deg": roll_deg},
        "platform": {"altitude_km": 500.0, "latitude_deg": 40.0, "longitude_deg": 30.0},
        "render": {"subsamples": MOST_SUBSAMPLES},
    }
    camera = {
        "camera": {"width": 20, "height": 16, "fov_deg": 8.0},
        "band": [{"name": name, "kind": "thermal", "lo_um": lo, "hi_um": hi} for name, lo, hi in bands],
    }
    return SceneSpec.model_validate(scene | tables), CameraSpec.model_validate(camera)


def _compare(reference: RadianceFrame, ours: RadianceFrame, band: str, noise: float) -> None:
    """Compare the ground and four heights of limb; ``noise`` is the relative error of the ground at most.

    Groups darker than a hundredth of the brightest pixel are left out: there a few paths hold all the light, and their
    scatter is no estimate of an error.
    """
    height, hit = ours.maps["tangent_height"] / 1e3, ours.maps["hit"]
    groups = {"ground": hit == Hit.SURFACE}
    for low, high in ((0, 20), (20, 40), (40, 60), (60, 100)):
        groups[f"{low} to {high} km"] = (hit == Hit.ATMOSPHERE) & (height >= low) & (height < high)
    assert groups["ground"].any()
    error, value = reference.maps[f"standard_error.{band}"].astype(float), ours.radiance[band].astype(float)
    for name, mask in groups.items():
        total = value[mask].sum()
        if mask.any() and total > 0.01 * mask.sum() * value.max():
            ratio = reference.radiance[band][mask].sum(dtype=float) / total
            sigma = np.sqrt((error[mask] ** 2).sum()) / total
            assert abs(ratio - 1.0) < KNOWN + 3.0 * sigma, (band, name, ratio, sigma)
    ground = groups["ground"]
    # a comparison so noisy that it could not fail would be none: a kelvin of ground is 1.5 % of the window
    assert np.sqrt((error[ground] ** 2).sum()) / value[ground].sum() < noise
    _check_own_word(reference, band)


def _check_own_word(reference: RadianceFrame, band: str) -> None:
    """Check what the reference says of the deterministic frame, by Student's t with 7 degrees of freedom: eight passes.

    Squares of t have the mean 1.4 and the variance 7.84; three standard errors of their mean.
    """
    found = reference.render["deterministic_frame_differs"][band]
    assert abs(found["mean"]) < 3.0
    spread = 3.0 * np.sqrt(7.84 / found["pixels"])
    assert abs(found["rms"] ** 2 - 1.4) < spread < 0.7


def test_bare_ground_shines_as_a_grey_body() -> None:
    """Seen straight down without air: emissivity times Planck's integral, and the black sky reflected."""
    bare = {"atmosphere": {"profile": "none"}, "surface": {"emissivity": 0.9, "temperature_k": 290.0}}
    scene, camera = _scene(roll_deg=0.0, **bare)
    frame = render_reference(scene, camera, spp=128)
    for band in camera.band:

        def planck(um: float) -> float:
            x = um * 1e-6
            return 2e-6 * h * c**2 / x**5 / np.expm1(h * c / (x * k * 290.0))

        expected = 0.9 * quad(planck, band.lo_um, band.hi_um)[0]
        value, error = frame.radiance[band.name], frame.maps[f"standard_error.{band.name}"]
        sigma = np.sqrt((error.astype(float) ** 2).mean() / error.size)
        assert sigma < 2e-3 * expected
        assert abs(value.mean(dtype=float) - expected) < 1e-3 * expected + 3.0 * sigma


def test_frame_equals_the_monte_carlo() -> None:
    """Midlatitude winter over grey ground that reflects a fifth of the sky, and the frame's own word on it."""
    air = {"profile": "midlatitude_winter", "refraction": False}
    scene, camera = _scene(atmosphere=air, surface={"emissivity": 0.8})
    reference, ours = render_reference(scene, camera, spp=4096), render_frame(scene, camera)
    assert reference.truth == ours.truth
    for band in ("window", "co2"):
        _compare(reference, ours, band, 1e-3)
    once, again = (render_reference(scene, camera, spp=16).radiance["co2"].tobytes() for _ in range(2))
    assert once == again


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ir-limb-equinox", "ir-cirrus-limb", "ir-day-side"])
def test_shipped_scenes_equal_the_monte_carlo(name: str) -> None:
    """Four bands over seas that mirror and land by day, air by latitude, thin cirrus."""
    source = hv.Scene.from_file(name)
    air = source.spec.atmosphere.model_copy(update={"refraction": False})
    render = source.spec.render.model_copy(update={"subsamples": MOST_SUBSAMPLES})
    scene = source.spec.model_copy(update={"atmosphere": air, "render": render})
    camera = resized(source.camera.spec, 40, 32, "size")
    reference, ours = render_reference(scene, camera, spp=2048), render_frame(scene, camera)
    for band in ("co2", "co2-narrow", "lwir", "window"):
        _compare(reference, ours, band, 1e-3)
