"""Pictures: detector images in grey, radiance in colour, thermal bands as temperatures, sheets and galleries of them.

*Detector images*: grey levels run from the 1st to the 99.5th percentile of the pixels that are not saturated, so that
neither the Sun's blob nor a hot pixel decides them, and over no less than 4 % of full scale, so that the noise of a
dark frame stays dark. A gamma of 1.6 shows the fading limb.

*Radiance*: each of three bands is divided by the sunlight in it, so that a white, level ground under the Sun's zenith
is (1, 1, 1). The brightest of the three is then compressed, and the colour kept::

    shown = asinh(k v / v_white) / asinh(k)

``v_white`` is the 99.5th percentile of the pixels that light falls into, and k = 12: three decades fit.

*Brightness temperature*: all thermal bands of a frame, two to a row, each row on one colour scale. A scale spans the
temperatures of ground, clouds and low limb in its row, and goes on to SPAN_K or MARGIN_K below them: wide enough for
the limb to fade into space, which is black, and narrow enough for a carbon dioxide band, whose whole disc is within
ten kelvin, to show anything. What is hotter than the scale, the Sun, has the colour of its upper end.
"""

from __future__ import annotations

import base64
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, command_line
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.spectral.planck import brightness_temperature_k
from horizonval.frame import DetectorImage, Hit, RadianceFrame
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs
from horizonval.report import page
from horizonval.report.load import load_run
from horizonval.report.plots import house_style
from horizonval.spec.camera import Band

# ---------------------------------------------------------------------------------------------- detector images in grey

GAMMA = 1.6
GREY_PERCENTILES = (1.0, 99.5)
SMALLEST_RANGE = 0.04
CARD_SIDE_PX = 384
"""Longest side of a picture on a card of a page."""
CARD_QUALITY = 82
LOSSLESS_PX = 64
"""Longest side of images whose cards are lossless: their pixels are seen one by one."""


def grey_levels(image: DetectorImage) -> tuple[NDArray[np.uint8], float, float]:
    """Return 8-bit grey levels, shape (H, W), and the digital numbers that became black and white."""
    dn = image.dn.astype(np.float64)
    usable = dn[dn < image.full_scale]
    low, high = np.percentile(usable, GREY_PERCENTILES) if usable.size else (0.0, float(image.full_scale))
    high = max(high, low + SMALLEST_RANGE * image.full_scale)
    level = np.clip((dn - low) / (high - low), 0.0, 1.0) ** (1 / GAMMA)
    return np.rint(255 * level).astype(np.uint8), float(low), float(high)


def card_uri(grey: NDArray[np.uint8]) -> str:
    """Return grey levels as a ``data:`` URI for a card, lossless if tiny, else compressed and perhaps reduced."""
    if max(grey.shape) <= LOSSLESS_PX:
        return png_uri(grey)
    scale = min(1.0, CARD_SIDE_PX / max(grey.shape))
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return _uri("jpeg", _encoded(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, CARD_QUALITY]))


def png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture, shape (H, W) or (H, W, 3), as the bytes of a PNG file."""
    return _encoded(".png", picture if picture.ndim == 2 else picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def png_uri(picture: NDArray[np.uint8]) -> str:
    """Return a picture as a PNG in a ``data:`` URI."""
    return _uri("png", png(picture))


def _encoded(suffix: str, bgr: Any, options: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, bgr, options)
    if not done:
        raise RuntimeError(f"OpenCV cannot write {suffix}")
    return data.tobytes()


def _uri(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


# -------------------------------------------------------------------------------------------------- radiance in colour

STRETCH = 12.0
WHITE_PERCENTILE = 99.5
DARKEST = 1e-12


@dataclass(frozen=True)
class ToneMapped:
    """An 8-bit sRGB picture, shape (H, W, 3), and the reflectance shown as white."""

    rgb: NDArray[np.uint8]
    white: float


def tone_mapped(reflectance: NDArray[np.float64]) -> ToneMapped:
    """Return the picture of red, green and blue radiances relative to a white ground, shape (H, W, 3)."""
    brightest = reflectance.max(axis=-1)
    lit = brightest[brightest > DARKEST]
    white = float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 1.0
    level = np.arcsinh(STRETCH * brightest / white) / np.arcsinh(STRETCH)
    colour = reflectance / np.maximum(brightest, DARKEST)[..., None]
    linear = np.clip(level[..., None] * colour, 0.0, 1.0)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return ToneMapped(np.rint(255.0 * srgb).astype(np.uint8), white)


LOW_LIMB_M = 15e3
"""Tangent height up to which air determines the infrared colour scale, with ground and clouds."""


def frame_picture(frame: RadianceFrame) -> NDArray[np.uint8]:
    """Return a picture of a frame, shape (H, W, 3), sRGB.

    Three solar bands give colour, the longest wavelength red; other numbers give the first in grey. Without solar bands
    all thermal ones are shown as brightness temperatures with their scale.
    """
    shown = [band for band in frame.truth.camera_spec.band if band.name in frame.radiance]
    solar = [band for band in shown if band.kind == "solar"]
    if not solar:
        return infrared_picture([thermal_panel(band, frame) for band in shown])
    chosen = sorted(solar, key=bands.reference_wavelength_um, reverse=True) if len(solar) == 3 else [solar[0]] * 3
    when = datetime.fromisoformat(frame.truth.epoch_utc)
    return tone_mapped(np.stack([reflectance(frame.radiance[b.name], b, when) for b in chosen], axis=-1)).rgb


def reflectance(radiance: NDArray[np.float32], band: Band, epoch_utc: datetime) -> FloatArray:
    """Return a solar band's radiance relative to a white ground under the Sun's zenith, in the shape of the image."""
    _, distance_m = sun_itrs(epoch_utc)
    distance_au = distance_m / AU_M
    if band.lo_um is not None and band.hi_um is not None:
        irradiance = sunlight.band_irradiance(band.lo_um, band.hi_um, distance_au)
    else:
        wavelength_um, weight_um = bands.sampled(band)
        irradiance = float(sunlight.irradiance(wavelength_um, distance_au) @ weight_um)
    return radiance.astype(np.float64) / (irradiance / np.pi)


def thermal_panel(band: Band, frame: RadianceFrame) -> ThermalPanel:
    """Return a thermal band of a frame as brightness temperatures, with the pixels that determine their scale."""
    hit, height = frame.maps["hit"], frame.maps["tangent_height"]
    counts = (hit == Hit.SURFACE) | (hit == Hit.CLOUD) | ((hit == Hit.ATMOSPHERE) & (height < LOW_LIMB_M))
    lo, hi = bands.limits_um(band)
    return ThermalPanel(
        f"{band.name}: {lo:g} to {hi:g} µm", brightness_temperature_k(band, frame.radiance[band.name]), counts
    )


# --------------------------------------------------------------------------- thermal bands as brightness temperatures

SPAN_K = 60.0
"""Minimum span of a scale."""
MARGIN_K = 15.0
STEP_K = 5.0
SCALE_PERCENTILES = (0.5, 99.8)
COLOURS = "inferno"
PER_ROW = 2
PANEL_PX = 320
"""Smallest width of a band's picture; narrower images are enlarged by whole pixels."""
_DPI = 100
_EDGE, _GAP, _HEAD, _BAR, _NUMBERS = 12, 10, 26, 12, 62
_DARK: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.color": "#e6e8ec",
    "ytick.color": "#e6e8ec",
    "axes.labelcolor": "#e6e8ec",
    "figure.facecolor": "#171a20",
}


@dataclass(frozen=True)
class ThermalPanel:
    """One band of a frame: its brightness temperature, shape (H, W), 0 where there is no radiance.

    ``counts`` marks the pixels that determine the scale; none means all.
    """

    title: str
    temperature_k: NDArray[np.float64]
    counts: NDArray[np.bool_]


def scale_k(panels: Sequence[ThermalPanel]) -> tuple[float, float]:
    """Return the temperatures shown as black and as brightest in the pictures of some bands."""
    seen = np.concatenate([p.temperature_k[p.counts] for p in panels])
    if not seen.size:
        seen = np.concatenate([p.temperature_k.ravel() for p in panels])
    coldest, warmest = np.percentile(seen, SCALE_PERCENTILES)
    top = STEP_K * math.ceil(warmest / STEP_K)
    return max(0.0, STEP_K * math.floor(min(coldest - MARGIN_K, top - SPAN_K) / STEP_K)), top


def infrared_picture(panels: Sequence[ThermalPanel]) -> NDArray[np.uint8]:
    """Return the picture of the bands of one frame with their colour bars, shape (H, W, 3), sRGB."""
    rows = [panels[i : i + PER_ROW] for i in range(0, len(panels), PER_ROW)]
    height, width = panels[0].temperature_k.shape
    scale = max(1, math.ceil(PANEL_PX / width))
    w, h = scale * width, scale * height
    bar_x = _EDGE + len(rows[0]) * (w + _GAP)
    total_w, total_h = bar_x + _BAR + _NUMBERS, len(rows) * (_HEAD + h) + _EDGE
    with house_style(_DARK):
        # A quarter of a pixel more: 2.3 inches are 229.999 px, and some versions of matplotlib cut.
        figure = Figure(figsize=((total_w + 0.25) / _DPI, (total_h + 0.25) / _DPI), dpi=_DPI)
        canvas = FigureCanvasAgg(figure)

        for r, row in enumerate(rows):
            y = _HEAD + r * (h + _HEAD)
            colours = ScalarMappable(Normalize(*scale_k(row)), COLOURS)
            for c, panel in enumerate(row):
                x = _EDGE + c * (w + _GAP)
                # Copied pixel by pixel: axes may round the image's origin.
                figure.figimage(_enlarged(colours.to_rgba(panel.temperature_k, bytes=True), scale), x, total_h - y - h)
                figure.text(x / total_w, 1 - (y - 7) / total_h, panel.title, va="baseline")
            bar = figure.add_axes((bar_x / total_w, 1 - (y + h) / total_h, _BAR / total_w, h / total_h))
            legend = figure.colorbar(colours, cax=bar)
            legend.set_label("brightness temperature [K]")
            bar.spines["outline"].set_visible(False)
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _enlarged(picture: NDArray[np.uint8], scale: int) -> NDArray[np.uint8]:
    return picture.repeat(scale, axis=0).repeat(scale, axis=1)


# ------------------------------------------------------------------------------------------------------ contact sheet

TILE_PX = 240
GAP_PX = 14
CAPTION_PX = 40
MARGIN_PX = 10
MOST_CASES = 400
LOWEST_TILE_PX = 24
"""Height of the strip that shows a linear array."""


@dataclass(frozen=True)
class Tile:
    """One image of a sheet, or red, green and blue of one."""

    name: str
    images: tuple[DetectorImage, ...]


def tiles_of(sources: Sequence[Path]) -> list[Tile]:
    """Return the images of files and of run folders, in order and with all bands.

    Raises ``UserError``: a missing file, a file without image, or a run without images or with too many for a sheet.
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
        views = [view for view in run.views if view.image is not None]
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
    with house_style({}):
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
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
        rgb = np.asarray(canvas.buffer_rgba())[..., :3]
    return png(rgb)


def _drawn(tile: Tile) -> tuple[NDArray[np.uint8], tuple[str, str]]:
    """Return the picture at a tile's width, in grey or in colour, and its two lines of text."""
    first = tile.images[0]
    # All colours share the scale, so that white stays white.
    dn = np.concatenate([image.dn for image in tile.images])
    level, black, white = grey_levels(replace(first, dn=dn))
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


# ------------------------------------------------------------------------------------------------------------ gallery


@dataclass(frozen=True)
class Exhibit:
    """One picture: its scene's name, a description, and an optional remark on the picture."""

    name: str
    caption: str
    rgb: NDArray[np.uint8]
    remark: str = ""

    @property
    def png(self) -> bytes:
        """The picture as a PNG file."""
        return png(self.rgb)

    @property
    def uri(self) -> str:
        """The picture as ``data:`` URI."""
        return png_uri(self.rgb)


GALLERY_TITLE = "horizonval: gallery of scenes"


def write_gallery(visible: Sequence[Exhibit], infrared: Sequence[Exhibit], folder: Path) -> Path:
    """Write ``folder/index.html``, a page of pictures with captions, and return its path."""
    path = folder / "index.html"
    text = page.render("gallery.html", title=GALLERY_TITLE, heading="Scenes", visible=visible, infrared=infrared)
    page.write(path, text)
    return path
