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
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

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


DRAWS = (1, 2, 3, 4)
"""Seeds of clouds: what stands in the middle of the disc, a tenth of it, is one draw. Limb over centre by the power
of the contrasts is 0.61 to 0.84 in twelve of them, 0.70 in the mean."""

Disc = dict[str, FloatArray]


def _radius() -> FloatArray:
    """Return the distance from the disc's middle in its radii."""
    row, column = np.indices((PIXELS, PIXELS)) - 0.5 * (PIXELS - 1)
    return np.asarray(np.hypot(row, column) / (DISC_RADIUS * PIXELS))


@pytest.fixture(scope="module")
def discs() -> list[Disc]:
    """Radiance by channel, for every draw of the month's clouds."""
    activate()
    half = 0.5 * 1080.0 * 1.0063115862290796e-05
    bands = [
        {"name": n, "kind": "solar", "lo_um": w - 0.005, "hi_um": w + 0.005, "nodes": 1} for n, w in CHANNELS.items()
    ]
    lens = {"width": PIXELS, "height": PIXELS, "fov_deg": float(2.0 * np.degrees(np.arctan(half)))}
    camera = CameraSpec.model_validate({"camera": lens, "band": bands})
    found = []
    for seed in DRAWS:
        scene = {
            "camera": {"file": "test"},
            "platform": {
                "epoch_utc": datetime(2025, 6, 13, 21, 6, 4, tzinfo=UTC),
                "latitude_deg": 19.206,
                "longitude_deg": -142.943,
                "altitude_km": 1_450_100.0 - 6371.0,
            },
            "surface": {"kind": "earth"},
            "clouds": {"seed": seed},
        }
        frame = render_frame(SceneSpec.model_validate(scene), camera)
        found.append({name: frame.radiance[name].astype(float) for name in CHANNELS})
    return found


def power_of(disc: Disc) -> float:
    """Return the power of radiance that brings the three contrasts nearest to the photograph's."""
    ours = np.log([contrast(disc[name], _radius()) for name in CHANNELS])
    theirs = np.log([CONTRAST[name] for name in CHANNELS])
    return float(np.sum(theirs * ours) / np.sum(ours**2))


@pytest.mark.slow
def test_contrast_of_the_channels(discs: list[Disc]) -> None:
    """Within 25 % in every draw: 7.2, 4.8 and 3.1 in red, green and blue with powers of 0.66 to 0.68.

    The power is fitted to these three ratios, so that two of them are judged, and the power itself: display curves have
    0.4 to 0.8.
    """
    for disc in discs:
        power = power_of(disc)
        ours = np.array([contrast(disc[name], _radius()) for name in CHANNELS])
        assert 0.4 < power < 0.8
        assert ours**power == pytest.approx([CONTRAST[name] for name in CHANNELS], rel=0.25)


@pytest.mark.slow
def test_centre_to_limb(discs: list[Disc]) -> None:
    """Limb over centre, the draws' mean, within 15 % of that of two photographs, by the power of the contrasts.

    One draw scatters by 9 %, the mean of four by half of that.
    """
    ours = [limb_over_centre(disc["green"], _radius()) ** power_of(disc) for disc in discs]
    assert np.mean(ours) == pytest.approx(np.mean(CENTRE_TO_LIMB), rel=0.15)
