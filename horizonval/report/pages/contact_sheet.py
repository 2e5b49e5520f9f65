"""Contact sheet: detector images side by side in one picture, each above its name.

Grey levels are those of :mod:`horizonval.report.figures.picture`, chosen for each image by itself; the line below the
name says which digital numbers became black and white, and how much of the image is saturated. Of a run's case in red,
green and blue the three images make one in colour, as the converter gave them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from horizonval.core.errors import UserError, command_line
from horizonval.frame import DetectorImage
from horizonval.report.figures.picture import tone_mapped
from horizonval.report.load import load_run

TILE_PX = 240
GAP_PX = 14
CAPTION_PX = 40
MARGIN_PX = 10
DPI = 100
MOST_CASES = 400
LOWEST_TILE_PX = 24
"""A row of detectors is drawn as a strip of this height."""


@dataclass(frozen=True)
class Tile:
    """One image of a sheet, or red, green and blue of one."""

    name: str
    images: tuple[DetectorImage, ...]


def tiles_of(sources: Sequence[Path]) -> list[Tile]:
    """Return the images of files and of the folders of runs, in order; of several bands all.

    Raises
    ------
    UserError
        No such file, no image, a run without a single one, or with too many for a sheet.
    """
    from horizonval.store.exr import read_image

    tiles = []
    for source in sources:
        if not source.is_dir():
            tiles.append(Tile(source.stem, (read_image(source),)))
            continue
        run = load_run(source, MOST_CASES)
        if any(not view.shown for view in run.views):
            raise UserError(
                f"a run of {len(run.cases)} frames",
                where=str(source),
                expected=f"at most {MOST_CASES} on one sheet",
                fix=f"name the images, see {command_line('archive', 'ls', source)}",
            )
        # All heads of a scene together show the first one's image, which has a tile of its own.
        views = [view for view in run.views if view.image is not None and not view.head_paths]
        for case, group in itertools.groupby(views, lambda view: view.case):
            tiles += _tiles_of_case(case, {view.band: view.image for view in group if view.image is not None})
    if not tiles:
        raise UserError("no images", where=", ".join(map(str, sources)), expected="detector images, or a finished run")
    return tiles


def _tiles_of_case(case: str, images: dict[str, DetectorImage]) -> list[Tile]:
    colours = {band[:1].lower(): image for band, image in images.items()}
    if len(images) == 3 and set(colours) == set("rgb"):
        return [Tile(case, (colours["r"], colours["g"], colours["b"]))]
    return [Tile(case if len(images) == 1 else f"{case} [{band}]", (image,)) for band, image in images.items()]


def contact_sheet(tiles: Sequence[Tile], columns: int) -> bytes:
    """Return a PNG file with the tiles in rows; the same tiles give the same bytes."""
    columns = min(columns, len(tiles))
    rows = [tiles[i : i + columns] for i in range(0, len(tiles), columns)]
    tiles_drawn = [[_drawn(tile) for tile in row] for row in rows]
    heights = [max(grey.shape[0] for grey, _ in row) + CAPTION_PX for row in tiles_drawn]
    width = 2 * MARGIN_PX + columns * (TILE_PX + GAP_PX) - GAP_PX
    height = 2 * MARGIN_PX + sum(heights) + GAP_PX * (len(rows) - 1)
    with matplotlib.rc_context():
        # A user's own matplotlibrc must not show.
        matplotlib.rcdefaults()
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        top = MARGIN_PX
        for row, row_height in zip(tiles_drawn, heights, strict=True):
            for column, (grey, captions) in enumerate(row):
                left = MARGIN_PX + column * (TILE_PX + GAP_PX)
                figure.figimage(grey, left, height - top - grey.shape[0], cmap="gray", vmin=0, vmax=255, origin="upper")
                for line, text in enumerate(captions):
                    y = height - top - grey.shape[0] - 15 - 14 * line
                    figure.text(left / width, y / height, text, fontsize=7.5 - line, color=("black", "0.35")[line])
            top += row_height + GAP_PX
        canvas.draw()
        bgr = np.asarray(canvas.buffer_rgba())[..., 2::-1]
    done, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise RuntimeError("OpenCV cannot write PNG")
    return data.tobytes()


def _drawn(tile: Tile) -> tuple[NDArray[np.uint8], tuple[str, str]]:
    """Return the picture, as wide as a tile, in grey or in colour, and its two lines of text."""
    first = tile.images[0]
    # All colours share the scale, so that white stays white.
    dn = np.concatenate([image.dn for image in tile.images])
    level, black, white = tone_mapped(replace(first, dn=dn))
    planes = np.split(level, len(tile.images))
    picture = planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
    scale = TILE_PX / max(first.dn.shape)
    size = (max(1, round(first.dn.shape[1] * scale)), max(1, round(first.dn.shape[0] * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
    if small.shape[0] < LOWEST_TILE_PX:
        small = np.repeat(small, math.ceil(LOWEST_TILE_PX / small.shape[0]), axis=0)
    saturated = float(np.mean(dn >= first.full_scale))
    parts = [f"{black:.0f} to {white:.0f} of {first.full_scale}"]
    if saturated > 0:
        parts.append(f"{100 * saturated:.2g} % saturated")
    if "exposure_s" in first.observation:
        parts.append(f"{1e3 * first.observation['exposure_s']:.2g} ms")
    return np.asarray(small, dtype=np.uint8), (tile.name, ", ".join(parts))
