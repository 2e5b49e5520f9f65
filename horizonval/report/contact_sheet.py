"""Contact sheet: detector images side by side in one picture, each under its name.

Grey levels are those of :mod:`horizonval.report.picture`, chosen for each image by itself; the line below the name says
which digital numbers became black and white, and how much of the image is saturated.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from horizonval.errors import UserError
from horizonval.frame import DetectorImage
from horizonval.report.load import load_run
from horizonval.report.picture import tone_mapped

TILE_PX = 300
GAP_PX = 14
CAPTION_PX = 40
MARGIN_PX = 10
DPI = 100
LOWEST_TILE_PX = 24
"""A row of detectors is drawn as a strip of this height."""


@dataclass(frozen=True)
class Tile:
    """One image of a sheet."""

    name: str
    image: DetectorImage


def tiles_of(sources: Sequence[Path]) -> list[Tile]:
    """Return the images of files and of the folders of runs, in order; of several bands all.

    Raises
    ------
    UserError
        No such file, no image, or a run without a single one.
    """
    from horizonval.archive.exr import read_image

    tiles = []
    for source in sources:
        if not source.is_dir():
            tiles.append(Tile(source.stem, read_image(source)))
            continue
        views = [view for view in load_run(source).views if view.image is not None]
        many = {view.case for view in views if sum(other.case == view.case for other in views) > 1}
        for view in views:
            assert view.image is not None
            tiles.append(Tile(f"{view.case} [{view.band}]" if view.case in many else view.case, view.image))
    if not tiles:
        raise UserError("no images", where=", ".join(map(str, sources)), expected="detector images, or a finished run")
    return tiles


def contact_sheet(tiles: Sequence[Tile], columns: int) -> bytes:
    """Return a PNG file with the tiles in rows; the same tiles give the same bytes."""
    columns = min(columns, len(tiles))
    rows = [tiles[i : i + columns] for i in range(0, len(tiles), columns)]
    drawn = [[_drawn(tile) for tile in row] for row in rows]
    heights = [max(grey.shape[0] for grey, _ in row) + CAPTION_PX for row in drawn]
    width = 2 * MARGIN_PX + columns * (TILE_PX + GAP_PX) - GAP_PX
    height = 2 * MARGIN_PX + sum(heights) + GAP_PX * (len(rows) - 1)
    with matplotlib.rc_context():
        # A user's own matplotlibrc must not show.
        matplotlib.rcdefaults()
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)
        top = MARGIN_PX
        for row, row_height in zip(drawn, heights, strict=True):
            for column, (grey, captions) in enumerate(row):
                left = MARGIN_PX + column * (TILE_PX + GAP_PX)
                figure.figimage(grey, left, height - top - grey.shape[0], cmap="gray", vmin=0, vmax=255, origin="upper")
                for line, text in enumerate(captions):
                    y = height - top - grey.shape[0] - 15 - 14 * line
                    figure.text(left / width, y / height, text, fontsize=7.5 - line, color=("black", "0.35")[line])
            top += row_height + GAP_PX
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    return stream.getvalue()


def _drawn(tile: Tile) -> tuple[NDArray[np.uint8], tuple[str, str]]:
    """Return the grey picture, as wide as a tile, and its two lines of text."""
    grey, black, white = tone_mapped(tile.image)
    scale = TILE_PX / max(grey.shape)
    size = tuple(max(1, round(side * scale)) for side in reversed(grey.shape))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
    if small.shape[0] < LOWEST_TILE_PX:
        small = np.repeat(small, math.ceil(LOWEST_TILE_PX / small.shape[0]), axis=0)
    saturated = float(np.mean(tile.image.dn >= tile.image.full_scale))
    parts = [f"{black:.0f} to {white:.0f} of {tile.image.full_scale}"]
    if saturated > 0:
        parts.append(f"{100 * saturated:.2g} % saturated")
    if "exposure_s" in tile.image.observation:
        parts.append(f"{1e3 * tile.image.observation['exposure_s']:.2g} ms")
    return np.asarray(small, dtype=np.uint8), (tile.name, ", ".join(parts))
