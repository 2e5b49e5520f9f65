"""Contact sheets: what is on them, in which order, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.report.pages import contact_sheet
from horizonval.report.pages.contact_sheet import GAP_PX, MARGIN_PX, TILE_PX, Tile
from horizonval.store.exr import write_image


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
    png = contact_sheet.contact_sheet(tiles, 3)
    assert png == contact_sheet.contact_sheet(tiles, 3)
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


def test_three_colours_make_one_picture(make_image: Any) -> None:
    red, green, blue = square(300, make_image), square(100, make_image), square(100, make_image)
    picture = decoded(contact_sheet.contact_sheet([Tile("colour", (red, green, blue))], 5))
    b, g, r = picture[MARGIN_PX + 100, MARGIN_PX + TILE_PX - 20].astype(int)
    assert r == 255
    assert b == g < 200


def test_a_line_of_pixels_is_a_strip(make_image: Any) -> None:
    line = replace(make_image(), dn=np.arange(160, dtype=np.uint16)[None, :])
    picture = decoded(contact_sheet.contact_sheet([Tile("line", (line,))], 5))
    assert (picture[MARGIN_PX : MARGIN_PX + 24, MARGIN_PX] == 0).all()


def test_files_and_what_is_refused(make_image: Any, tmp_path: Path) -> None:
    write_image(tmp_path / "one.exr", make_image())
    (tile,) = contact_sheet.tiles_of([tmp_path / "one.exr"])
    assert tile.name == "one"
    with pytest.raises(UserError, match=r"no run\.json"):
        contact_sheet.tiles_of([tmp_path])
    with pytest.raises(UserError, match=r"none\.exr"):
        contact_sheet.tiles_of([tmp_path / "none.exr"])
