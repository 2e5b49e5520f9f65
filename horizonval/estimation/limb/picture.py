"""An image before any search: one grey plane, checked, with its noise, percentiles, smaller copies and directions.

Colour becomes the plain mean of its channels: luminance weights would mute the blue of the daylight limb, and the order
of channels does not matter. The checks ensure what later steps assume: two dimensions, a few pixels, finite numbers,
and some pixels between darkness and saturation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject

MEDIAN_TO_SIGMA = 1.4826
"""Ratio of standard deviation to median absolute deviation of normal variables, robust to outliers."""
ROSE_SIGMAS = 5.0
"""Signal-to-noise ratio from which a feature is visible (Rose's criterion)."""
TRIM_SIGMAS = 3.5
"""Robust standard deviations beyond which a value of many is left out: of normal ones one of two thousand is."""


def rounding_variance(values: FloatArray) -> float:
    """Return the variance of rounding in values of finite numbers: that of whole steps where all are whole, else 0.

    Where the noise is smaller, nearly all pixels of an even field have one number, and the others look like outliers.
    """
    return 1.0 / 12.0 if np.array_equal(values, np.rint(values)) else 0.0


def median(values: NDArray[Any]) -> float:
    """Return the median of finite numbers, at least one, in the precision of their type."""
    return percentile(values, 50.0)


def percentile(values: NDArray[Any], q: float) -> float:
    """Return what :func:`numpy.percentile` does of finite numbers, at least one, in a fifth of its time."""
    flat = values.ravel()
    place = (flat.size - 1) * (q / 100.0)
    rank, share = int(place), place - int(place)
    # A selection takes ten times as long as a sort where many values are equal, as in gradients.
    parted = np.sort(flat) if flat.dtype.itemsize <= 4 else np.partition(flat, rank)
    low = parted[rank].astype(float) if flat.dtype.kind in "iu" else parted[rank]
    if share == 0.0:
        return float(low)
    rise = parted[rank + 1 :].min() - low
    return float(low + rise * share if share < 0.5 else low + rise - rise * (1.0 - share))


def to_grey(array: NDArray[Any]) -> FloatArray:
    """Return grey levels in digital numbers; a second (grey) or fourth (colour) channel is opacity and ignored.

    Raises ``ValueError``: the array has no image's shape or is not numeric.
    """
    data = np.asarray(array)
    if data.dtype.kind not in "buif":
        raise ValueError(f"a picture of numbers is needed, not {data.dtype}")
    if data.ndim == 2:
        return data.astype(np.float64)
    if data.ndim == 3 and data.shape[2] in (1, 2):
        return data[:, :, 0].astype(np.float64)
    if data.ndim == 3 and data.shape[2] in (3, 4):
        return np.asarray(data[:, :, :3].mean(axis=2, dtype=np.float64))
    raise ValueError(f"a picture of shape (H, W) or (H, W, 1..4) is needed, not {data.shape}")


SMALLEST_SIDE_PX = 8
"""A profile across an edge has five pixels at least, and one to either side to be moved by."""
COMMON_FULL_SCALES = (1.0, 255.0, 1023.0, 4095.0, 16383.0, 65535.0)
"""Full scales of float, 8, 10, 12, 14 and 16 bit images: a constant image at one of these is saturated, not dark."""
DARK_LEVEL = 0.2
"""Share of full scale below which the brightest pixels of an image without edges show an unlit scene."""
DARK_CONTRAST = 0.02
"""Contrast of full scale, five levels of eight bits: with less, and below :data:`DARK_LEVEL`, a scene is unlit."""


def check_image(image: FloatArray, full_scale: float | None = None) -> Refusal | None:
    """Return why an image (H, W) cannot hold a limb, or None; ``full_scale``: digital number of saturation."""
    if not isinstance(image, np.ndarray) or image.dtype.kind not in "buif":
        return Refusal(Outcome.BAD_INPUT, "the image is not an array of numbers")
    if image.ndim != 2:
        return Refusal(Outcome.BAD_INPUT, f"the image has {image.ndim} dimensions; a grey image has 2")
    if min(image.shape) < SMALLEST_SIDE_PX:
        rows, columns = image.shape
        reason = f"the image is {columns} x {rows} pixels; {SMALLEST_SIDE_PX} a side are needed"
        return Refusal(Outcome.BAD_INPUT, reason)
    low, high = float(image.min()), float(image.max())
    # Either of them is not finite if any pixel is not.
    if not (np.isfinite(low) and np.isfinite(high)):
        return Refusal(Outcome.BAD_INPUT, f"{int(image.size - np.isfinite(image).sum())} pixels are not finite")
    if high == low:
        return _flat(high, full_scale)
    share = 0.0 if full_scale is None else np.count_nonzero(image >= full_scale) / image.size
    # In a tenth of the pixels nothing is left to see a limb in.
    return Refusal(Outcome.SATURATED, f"{share:.0%} of the pixels are saturated") if share > 0.9 else None


def _flat(level: float, full_scale: float | None) -> Refusal:
    scales = COMMON_FULL_SCALES if full_scale is None else (full_scale,)
    if level in scales or (full_scale is not None and level >= full_scale):
        return Refusal(Outcome.SATURATED, f"every pixel is saturated at {level:g}")
    if level <= DARK_CONTRAST * scales[0]:
        return Refusal(Outcome.DARK, f"every pixel is {level:g}: nothing is lit")
    return Refusal(Outcome.NO_LIMB, f"every pixel is {level:g}: there is no contrast")


def saturated_pixels(image: FloatArray, full_scale: float | None = None) -> NDArray[np.bool_]:
    """Return where the image is saturated.

    Without ``full_scale`` its maximum counts as saturation if at least nine pixels share it, which noise does not do.
    """
    at_top = image >= (float(image.max()) if full_scale is None else full_scale)
    if full_scale is None and np.count_nonzero(at_top) < 9:
        return np.zeros(image.shape, dtype=bool)
    return np.asarray(at_top)


def smaller(image: FloatArray, camera: CameraModel, scale: int) -> tuple[FloatArray, CameraModel]:
    """Return an image and its camera with pixels ``scale`` times as wide; columns and rows left over are cut."""
    width, height = camera.width // scale, camera.height // scale
    whole = np.asarray(image, dtype=np.float64)[: height * scale, : width * scale]
    cx, cy = (camera.cx + 0.5) / scale - 0.5, (camera.cy + 0.5) / scale - 0.5
    small = replace(camera, width=width, height=height, fx=camera.fx / scale, fy=camera.fy / scale, cx=cx, cy=cy)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)), small


def scale_as_deep(camera: CameraModel, pixel_m: float, deep_m: float) -> int:
    """Return how many pixels of a size together see as much as a depth: a power of two, or 1."""
    scale = 1
    # A copy of 32 pixels has two windows of a fit, and a limb that bends.
    while scale * pixel_m < deep_m and min(camera.width, camera.height) >= 64 * scale:
        scale *= 2
    return scale


def in_wider_pixels(observation: Observation, scale: int) -> Observation:
    """Return what pixels ``scale`` times as wide would have seen; columns and rows left over are cut."""
    if scale == 1:
        return observation
    image, camera = smaller(observation.image, observation.camera, scale)
    lens = None if observation.lens is None else observation.lens.in_wider_pixels(scale)
    return replace(observation, image=image, camera=camera, lens=lens)


def in_whole(uv: FloatArray, scale: int) -> FloatArray:
    """Return places (n, 2) of a copy as those of the image that it was made of."""
    return np.asarray(scale * (uv + 0.5) - 0.5)


def pixel_directions(camera: CameraModel) -> FloatArray:
    """Return the unit directions in camera axes, shape (H, W, 3), read only; NaN where a pixel sees nothing.

    Those of the last two cameras are cached, 100 MB at most, because images of a flight share one camera.
    """
    large = camera.width * camera.height > 1 << 22
    return _pixel_directions.__wrapped__(camera) if large else _pixel_directions(camera)


@lru_cache(maxsize=2)
def _pixel_directions(camera: CameraModel) -> FloatArray:
    directions = unproject(camera, pixel_grid(camera))
    directions.flags.writeable = False
    return directions


IMMERKAER: FloatArray = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
"""Operator that measures noise and cancels levels and first derivatives."""
NOISE_FLOOR = 1e-3
"""Smallest noise relative to the range of levels: no picture is better than ten bits."""


class Picture:
    """A grey image with cached properties.

    ``image``: shape (H, W), finite, not constant (:func:`check_image`); ``full_scale``: digital number of saturation;
    ``saturated``: shape (H, W), a better saturation mask, if known.
    """

    def __init__(
        self, image: FloatArray, full_scale: float | None = None, saturated: NDArray[np.bool_] | None = None
    ) -> None:
        self.grey = np.asarray(image, dtype=np.float64)
        self.full_scale = full_scale
        self.saturated = saturated_pixels(self.grey, full_scale) if saturated is None else saturated

    @cached_property
    def single(self) -> NDArray[np.float32]:
        """The image in the precision that OpenCV filters in, shape (H, W)."""
        return self.grey.astype(np.float32)

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """Mean of every pixel and its eight neighbours, shape (H, W)."""
        return np.asarray(cv2.blur(self.single, (3, 3)), dtype=np.float32)

    @cached_property
    def credible_noise(self) -> float:
        """Standard deviation of the pixel noise, of a picture without any at least :data:`NOISE_FLOOR`."""
        return max(noise_sigma(self.single), NOISE_FLOOR * float(np.ptp(self.grey)))

    @cached_property
    def unclipped(self) -> FloatArray:
        """The image with NaN within 5 x 5 pixels of saturated ones, which may have charge from them; shape (H, W).

        Without a known full scale nothing is: the even Earth of an image without noise has one level, too.
        """
        if self.full_scale is None or not self.saturated.any():
            return self.grey
        near = cv2.dilate(self.saturated.astype(np.uint8), np.ones((5, 5), np.uint8))
        return np.where(near > 0, np.nan, self.grey)


def noise_sigma(image: NDArray[np.floating | np.uint8]) -> float:
    """Return the standard deviation of the pixel noise, blind to edges and smooth shading.

    By Immerkaer's operator (Computer Vision and Image Understanding 64, 300, 1996), with the median in place of the
    mean so that edges do not count, over some 128 rows and columns: 16 000 pixels know it to a percent.
    """
    step = max(min(image.shape) // 128, 1)
    signed = image.astype(np.int16) if image.dtype == np.uint8 else image

    def second_difference(rows: slice) -> NDArray[Any]:
        return signed[rows, :-2:step] - 2 * signed[rows, 1:-1:step] + signed[rows, 2::step]

    outer = second_difference(slice(0, -2, step)) + second_difference(slice(2, None, step))
    gain = float(np.linalg.norm(IMMERKAER)) / MEDIAN_TO_SIGMA
    return median(np.abs(outer - 2 * second_difference(slice(1, -1, step)))) / gain


def picture_of(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> Picture | Refusal:
    """Return an image that may hold a limb as a picture, or why it holds none; parameters as for :func:`find_limb`."""
    if (refusal := check_image(image, full_scale)) is not None:
        return refusal
    if image.shape != (camera.height, camera.width):
        return wrong_size(image, camera)
    return Picture(image, full_scale)


def wrong_size(image: FloatArray, camera: CameraModel) -> Refusal:
    """Return the refusal of an image (H, W) that is not its camera's."""
    size = f"{image.shape[1]} x {image.shape[0]} pixels, the camera {camera.width} x {camera.height}"
    return Refusal(Outcome.BAD_INPUT, f"the image is {size}")


FEWEST_POINTS = 8
"""Smallest number of points: three unknowns, and their scatter."""


@dataclass(frozen=True)
class LimbPoints:
    """Points of the Earth's limb in one image.

    ``uv``: shape (n, 2), (column, row) [px]; ``los_cam``: shape (n, 3), unit lines of sight; ``scale``: image pixels
    per pixel of the copy in which the limb is sharp.
    """

    uv: FloatArray
    los_cam: FloatArray
    scale: int = 1
