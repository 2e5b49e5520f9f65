"""Air that grows warmer upwards so fast that the low Sun has several images: frames are made all the same."""

from __future__ import annotations

import numpy as np
import pytest

import horizonval as hv

SMALL = {"width": 24, "height": 24}


def _frame(profile: str, sun_zenith_deg: float, *, refraction: bool) -> np.ndarray:
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera=SMALL)
    scene = hv.Scene(
        camera=camera,
        altitude_km=500,
        mount_roll_deg=65,
        sun={"zenith_deg": sun_zenith_deg, "azimuth_deg": 90.0},
        atmosphere={"profile": profile, "refraction": refraction},
        render={"orders": "single", "subsamples": 1, "nodes": 48},
    )
    return np.asarray(hv.render(scene).radiance["vis"])


def _by_refraction(profile: str, sun_zenith_deg: float) -> float:
    """Return what refraction changes, median of bright pixels."""
    seen, straight = (_frame(profile, sun_zenith_deg, refraction=refraction) for refraction in (True, False))
    assert np.isfinite(seen).all()
    assert (seen >= 0.0).all()
    bright = straight > 0.1 * straight.max()
    return float(np.median(np.abs(seen[bright] / straight[bright] - 1.0)))


@pytest.mark.parametrize(
    ("state", "sun_zenith_deg"),
    [
        ("ec2008-59", 89.5),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("ec2008-16", 89.5), ("ec2008-59", 50.0))),
    ],
)
def test_states_with_strong_inversions(state: str, sun_zenith_deg: float) -> None:
    """Refraction changes their light about as much as that of smoother air: bending at the ground differs by a half."""
    changed, of_smooth = (_by_refraction(name, sun_zenith_deg) for name in (f"weather:{state}", "us_standard"))
    assert of_smooth / 1.5 < changed < 1.5 * of_smooth
