"""Pictures: greys of detector images, colours of radiance and temperature, contact sheets."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import pytest
from synthetic import toy_image, truth_at

from horizonval.core.errors import UserError
from horizonval.frame import DetectorImage
from horizonval.report import pictures
from horizonval.report.pictures import (
    COLOURS,
    GAP_PX,
    MARGIN_PX,
    PANEL_PX,
    SPAN_K,
    TILE_PX,
    ThermalPanel,
    Tile,
    contact_sheet,
    infrared_picture,
    scale_k,
    tiles_of,
    tone_mapped,
)
from horizonval.store.exr import write_image


def test_the_sun_does_not_take_the_greys():
    image = toy_image(truth_at(roll_deg=66.0, sun_zenith_deg=100.0, sun_azimuth_deg=270.0))
    assert (image.dn == image.full_scale).sum() > 5
    grey, _, white = pictures.grey_levels(image)
    assert white < 0.7 * image.full_scale
    assert np.percentile(grey, 75) > 120


def test_noise_of_a_dark_frame_stays_in_its_place():
    noise = np.random.default_rng(2).normal(32, 0.5, (120, 160)).round().astype(np.uint16)
    grey, black, white = pictures.grey_levels(DetectorImage(noise, "vis", truth_at(), 1023))
    assert white - black >= 0.04 * 1023
    assert grey.mean() < 60


@pytest.mark.parametrize("level", [0, 1023])
def test_flat_images_have_a_picture(level):
    grey, _, _ = pictures.grey_levels(DetectorImage(np.full((3, 4), level, np.uint16), "vis", truth_at(), 1023))
    assert set(np.unique(grey)) <= {0, 255}


@pytest.mark.parametrize(("step", "kind"), [(16, "png"), (1, "jpeg")])
def test_pictures_of_cards_decode_to_the_image(step, kind):
    grey = pictures.grey_levels(toy_image(truth_at(roll_deg=66.0)))[0][::step, ::step].copy()
    head, data = pictures.card_uri(grey).split(",")
    assert head == f"data:image/{kind};base64"
    back = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
    if kind == "jpeg":
        assert back.shape == (288, 384)
    else:
        np.testing.assert_array_equal(back, grey)


def test_a_grey_scene_stays_grey_and_its_brightest_part_is_white() -> None:
    ramp = np.linspace(0.0, 1.0, 2001)[:, None, None] * np.ones((1, 4, 3)) * 3e-5
    picture = tone_mapped(ramp)
    assert (picture.rgb.max(axis=-1) == picture.rgb.min(axis=-1)).all()
    assert picture.rgb[-1, 0, 0] == 255
    assert picture.rgb[0, 0, 0] == 0
    assert 0.99 * 3e-5 < picture.white < 3e-5
    assert (np.diff(picture.rgb[:, 0, 0].astype(int)) >= 0).all()


def test_three_decades_below_white_are_still_seen_and_keep_their_colour() -> None:
    scene = np.ones((40, 40, 3))
    scene[0, 0] = (0.5e-3, 0.5e-3, 1e-3)
    dark = tone_mapped(scene).rgb[0, 0]
    assert dark[2] > dark[0] == dark[1] > 0


def panel(temperature_k: np.ndarray, title: str = "t") -> ThermalPanel:
    return ThermalPanel(title, temperature_k, temperature_k > 0)


def ramp(lo: float, hi: float, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    return np.linspace(lo, hi, shape[0] * shape[1]).reshape(shape)


def test_a_scale_reaches_from_the_warmest_down_to_cold_clouds() -> None:
    disc = ramp(223.0, 231.0)
    assert scale_k([panel(disc)]) == (235.0 - SPAN_K, 235.0)
    sky = disc.copy()
    sky[:30] = 0.0
    assert scale_k([panel(sky)]) == scale_k([panel(disc)]), "space does not count"
    lo, hi = scale_k([panel(ramp(190.0, 290.0)), panel(ramp(250.0, 298.0))])
    assert hi == 300.0
    assert lo < 190.0


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
    y, x = pictures._HEAD, pictures._EDGE
    block = picture[y : y + height, x : x + width]
    assert (block[::scale, ::scale] == block[scale - 1 :: scale, scale - 1 :: scale]).all(), "whole pixels"
    block = block[::scale, ::scale]
    expected = colours(np.clip((temperature - lo) / (hi - lo), 0, 1))[..., :3] * 255
    # A colour map has 256 steps; the picture may round to the one beside.
    step = np.abs(np.diff(colours(np.arange(256))[:, :3] * 255, axis=0)).max()
    assert np.abs(block - expected).max() <= step + 1
    assert (block[0] <= 4).all(), "space is black"


def test_equal_temperatures_give_equal_bytes() -> None:
    panels = [panel(ramp(200, 250), "co2: 14 to 16.3 µm")] * 3
    with matplotlib.rc_context({"image.cmap": "gray", "font.size": 30}):
        other = infrared_picture(panels)
    assert infrared_picture(panels).tobytes() == other.tobytes()


def decoded(png: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return np.asarray(picture)


def square(level: int, make_image: Any) -> Any:
    """An image of one level on the left, of twice that on the right, so that it has a range."""
    dn = np.full((40, 40), level, np.uint16)
    dn[:, 20:] *= 2
    return replace(make_image(), dn=dn)


def test_tiles_stand_in_rows(make_image: Any) -> None:
    tiles = [Tile(f"image-{i}", (square(100 + i, make_image),)) for i in range(5)]
    png = contact_sheet(tiles, 3)
    assert png == contact_sheet(tiles, 3)
    picture = decoded(png)
    assert picture.shape[1] == 2 * MARGIN_PX + 3 * TILE_PX + 2 * GAP_PX
    middle = MARGIN_PX + TILE_PX // 2
    for column in range(3):
        left = MARGIN_PX + column * (TILE_PX + GAP_PX)
        assert (picture[middle, left + 20] == 0).all(), "the darker half, just inside the tile"
        assert (picture[middle, left + TILE_PX - 20] == 255).all()
    # The last row has two.
    last = picture.shape[0] - MARGIN_PX - TILE_PX
    assert (picture[last, MARGIN_PX + 20] == 0).all()
    assert (picture[last:, MARGIN_PX + 2 * (TILE_PX + GAP_PX) :] == 255).all()


def test_files_and_what_is_refused(make_image: Any, tmp_path: Path) -> None:
    write_image(tmp_path / "one.exr", make_image())
    (tile,) = tiles_of([tmp_path / "one.exr"])
    assert tile.name == "one"
    with pytest.raises(UserError, match=r"no run\.json"):
        tiles_of([tmp_path])
    with pytest.raises(UserError, match=r"none\.exr"):
        tiles_of([tmp_path / "none.exr"])
