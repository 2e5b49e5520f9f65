"""Pictures of brightness temperature: every pixel its colour, the scale, and equal bytes."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest

from horizonval.report.figures import infrared
from horizonval.report.figures.infrared import COLOURS, PANEL_PX, SPAN_K, ThermalPanel, infrared_picture, scale_k


def panel(temperature_k: np.ndarray, title: str = "t") -> ThermalPanel:
    return ThermalPanel(title, temperature_k, temperature_k > 0)


def ramp(lo: float, hi: float, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    return np.linspace(lo, hi, shape[0] * shape[1]).reshape(shape)


def test_a_scale_reaches_from_the_warmest_down_by_its_least_span() -> None:
    disc = ramp(223.0, 231.0)
    assert scale_k([panel(disc)]) == (235.0 - SPAN_K, 235.0)
    sky = disc.copy()
    sky[:30] = 0.0
    assert scale_k([panel(sky)]) == scale_k([panel(disc)]), "space does not count"


def test_a_scale_reaches_below_cold_clouds() -> None:
    lo, hi = scale_k([panel(ramp(190.0, 290.0)), panel(ramp(250.0, 298.0))])
    assert hi == 300.0
    assert lo < 190.0


def test_a_sky_without_the_earth_has_a_scale() -> None:
    lo, hi = scale_k([panel(np.zeros((4, 5)))])
    assert 0.0 <= lo <= hi


@pytest.mark.parametrize(("shape", "scale"), [((12, 16), 20), ((24, 40), 8), ((10, 330), 1)])
def test_every_pixel_has_the_colour_of_its_temperature(shape: tuple[int, int], scale: int) -> None:
    temperature = ramp(200.0, 260.0, shape)
    temperature[0] = 0.0
    first, second = panel(temperature), panel(temperature[::-1])
    picture = infrared_picture([first, second])
    lo, hi = scale_k([first, second])
    colours = matplotlib.colormaps[COLOURS]
    height, width = shape[0] * scale, shape[1] * scale
    assert width >= PANEL_PX
    y, x = infrared._HEAD, infrared._EDGE
    block = picture[y : y + height, x : x + width]
    assert (block[::scale, ::scale] == block[scale - 1 :: scale, scale - 1 :: scale]).all(), "whole pixels"
    block = block[::scale, ::scale]
    expected = colours(np.clip((temperature - lo) / (hi - lo), 0, 1))[..., :3] * 255
    # A colour map has 256 steps; the picture may round to the one beside.
    step = np.abs(np.diff(colours(np.arange(256))[:, :3] * 255, axis=0)).max()
    assert np.abs(block - expected).max() <= step + 1
    assert (block[0] <= 4).all(), "space is black"


def test_bands_stand_two_to_a_row() -> None:
    one = infrared_picture([panel(ramp(200, 250))])
    two = infrared_picture([panel(ramp(200, 250))] * 2)
    four = infrared_picture([panel(ramp(200, 250))] * 4)
    assert two.shape[0] == one.shape[0]
    assert two.shape[1] > one.shape[1] + PANEL_PX
    assert four.shape[0] > 1.8 * two.shape[0]
    assert four.shape[1] == two.shape[1]


def test_equal_temperatures_give_equal_bytes() -> None:
    panels = [panel(ramp(200, 250), "co2: 14 to 16.3 µm")] * 3
    with matplotlib.rc_context({"image.cmap": "gray", "font.size": 30}):
        other = infrared_picture(panels)
    assert infrared_picture(panels).tobytes() == other.tobytes()
