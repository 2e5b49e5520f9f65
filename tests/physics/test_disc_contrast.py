"""A full disc with clouds of the Earth beside figures of a photograph: EPIC on DSCOVR, 2025-06-13 21:06 UTC.

The figures (98th over 2nd percentile within 0.9 of the radius, medians by cosine of the view angle) were taken from the
8-bit picture, whose tone curve is unknown. One power of radiance stands for it, the same for all three channels: three
ratios, one unknown. sRGB's would be 0.45, and 0.66 fits.

Air and haze are those of a scene that says nothing of them.
"""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.renderer.plugin.backend import activate
from horizonval.renderer.scene.frame import render_frame
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

PIXELS, DISC_RADIUS = 180, 437.08 / 1080.0
CHANNELS = {"red": 0.680, "green": 0.551, "blue": 0.443}
CONTRAST = {"red": 7.29, "green": 4.58, "blue": 3.25}
"""Of the photograph, 98th over 2nd percentile of 8-bit values."""
CENTRE_TO_LIMB = (93.0 / 119.0, 90.0 / 121.0)
"""Of two photographs, green: cosine of the view angle 0.1 to 0.2 over 0.95 to 1."""


def contrast(image: FloatArray, radius: FloatArray) -> float:
    """Return bright over dark: the 98th over the 2nd percentile within 0.9 of the disc's radius."""
    low, high = np.percentile(image[radius < 0.9], [2.0, 98.0])
    return float(high / low)


def limb_over_centre(image: FloatArray, radius: FloatArray) -> float:
    """Return the median near the limb over that in the middle, by cosine of the view angle."""
    cosine = np.sqrt(np.maximum(1.0 - radius**2, 0.0))
    limb, centre = (np.median(image[(cosine > a) & (cosine <= b)]) for a, b in ((0.1, 0.2), (0.95, 1.0)))
    return float(limb / centre)


@pytest.fixture(scope="module")
def disc() -> tuple[dict[str, FloatArray], FloatArray]:
    """Radiance by channel, and distance from the disc's middle in its radii."""
    activate()
    scene = {
        "camera": {"file": "test"},
        "platform": {
            "epoch_utc": datetime(2025, 6, 13, 21, 6, 4, tzinfo=UTC),
            "latitude_deg": 19.206,
            "longitude_deg": -142.943,
            "altitude_km": 1_450_100.0 - 6371.0,
        },
        "surface": {"kind": "earth"},
        "clouds": {"seed": 3},
    }
    half = 0.5 * 1080.0 * 1.0063115862290796e-05
    bands = [
        {"name": n, "kind": "solar", "lo_um": w - 0.005, "hi_um": w + 0.005, "nodes": 1} for n, w in CHANNELS.items()
    ]
    camera = {"width": PIXELS, "height": PIXELS, "fov_deg": float(2.0 * np.degrees(np.arctan(half)))}
    frame = render_frame(SceneSpec.model_validate(scene), CameraSpec.model_validate({"camera": camera, "band": bands}))
    row, column = np.indices((PIXELS, PIXELS)) - 0.5 * (PIXELS - 1)
    radius = np.hypot(row, column) / (DISC_RADIUS * PIXELS)
    return {name: frame.radiance[name].astype(float) for name in CHANNELS}, radius


@pytest.fixture(scope="module")
def power(disc: tuple[dict[str, FloatArray], FloatArray]) -> float:
    """The power of radiance that brings the three contrasts nearest to the photograph's: its tone curve is unknown."""
    images, radius = disc
    ours = np.log([contrast(images[name], radius) for name in CHANNELS])
    theirs = np.log([CONTRAST[name] for name in CHANNELS])
    return float(np.sum(theirs * ours) / np.sum(ours**2))


@pytest.mark.slow
def test_contrast_of_the_channels(disc: tuple[dict[str, FloatArray], FloatArray], power: float) -> None:
    """Within 25 %: 7.2, 4.8 and 3.1 in red, green and blue with a power of 0.66.

    The power is fitted to these three ratios, so that two of them are judged, and the power itself: display curves have
    0.4 to 0.8.
    """
    images, radius = disc
    ours = np.array([contrast(images[name], radius) for name in CHANNELS])
    assert 0.4 < power < 0.8
    assert ours**power == pytest.approx([CONTRAST[name] for name in CHANNELS], rel=0.25)


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    raises=AssertionError,
    reason="0.62 for 0.76 by the power of the contrasts, 19 % dark; by sRGB's own power 0.72, but then contrasts "
    "are too small by a third",
)
def test_centre_to_limb(disc: tuple[dict[str, FloatArray], FloatArray], power: float) -> None:
    """Limb over centre within 15 % of two photographs' mean, by the power of the contrasts."""
    images, radius = disc
    assert limb_over_centre(images["green"], radius) ** power == pytest.approx(np.mean(CENTRE_TO_LIMB), rel=0.15)
