"""The bench as a Mitsuba scene: a glowing rectangle before a stock pinhole camera in a dark room.

Rectangle, area light, camera, film and integrator are stock plugins; the panel's emission is a texture of ours, because
a bitmap fine enough for the stripes of two million pixels would take a gigabyte. Only light straight from the panel is
followed: nothing else in the room shines back.

A camera pixel covers a panel pixel or so with open and black parts, which random samples average slowly: 64 of them
leave 8 % of noise, more than the detector's own. The samples are therefore on a regular grid, ``FINE x FINE`` in each
pixel of the camera, and each takes the mean of the stripes over its square, which the texture gives in
closed form: the difference of the stripes' running sum at the square's two ends. The render has no noise.

**The lens blurs before the pixels sample.** Elsewhere in this package a frame is even within a pixel and the blur may
be applied to the pixels' means. The panel's stripes are finer than a pixel: sampled first, they would make a moire that
a real lens has already wiped out. So the film is ``FINE`` times finer than the camera, is blurred there, and only then
summed to pixels.

Single precision places a ray on the panel to 3e-5 mm, a ten-thousandth of a pixel.

**The panel.** A pixel of level ``v`` (0 to 255) has the radiance ::

    L(x, y) = [L_black + (L_white - L_black) (v / 255)^gamma] * stripe(x) * row(y) * backlight(x, y) * cos(angle)^k

``stripe``: each pixel has three upright stripes, red, green and blue, of which the black matrix leaves a part open; in
a camera's band they count by their share of white light. The picture is grey, so all three have the same level. ``row``
is the open part of the pixel's height. Both have mean 1, so that the mean radiance does not depend on the matrix.
``backlight`` falls off towards the rim and to one side, ``cos^k`` is how the panel dims when seen at an angle.

A *smooth* panel shows the same picture without levels and matrix: linear between the pixels' centres.

Figures: a 24 inch office panel of 1920 x 1080. White is 0.8 W m-2 sr-1 in 450 to 750 nm, near 250 cd m-2 of a white LED
behind colour filters. Neglected: the panel's refresh and the pulses of a dimmed backlight, which a global shutter open
for several of them does not see, and light from the room on the glass (the room is dark).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.reference.reference_scene import pinhole
from horizonval.systems.b.rig.bench import BenchPose


@dataclass(frozen=True)
class Panel:
    """A panel's build. Lengths in mm, radiances in W m-2 sr-1 in the camera's band.

    - ``contrast``: white over black;
    - ``stripe_share``: what red, green and blue have of white light in the camera's band; their sum is 1;
    - ``stripe_open``, ``row_open``: open part of a stripe's width and of a pixel's height;
    - ``backlight_fall``, ``backlight_slope``: relative loss from the middle to the corners, and from the left to the
      right edge;
    - ``viewing_power``: ``k``; 2.5 leaves 70 % at 30 deg;
    - ``smooth``: see the module text; backlight and viewing angle stay as they are.
    """

    width: int = 1920
    height: int = 1080
    pitch_mm: float = 0.2768
    gamma: float = 2.2
    white_w_m2_sr: float = 0.8
    contrast: float = 1000.0
    stripe_share: tuple[float, float, float] = (0.31, 0.41, 0.28)
    stripe_open: float = 0.75
    row_open: float = 0.85
    backlight_fall: float = 0.15
    backlight_slope: float = 0.05
    viewing_power: float = 2.5
    smooth: bool = False

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the lit area."""
        return self.width * self.pitch_mm, self.height * self.pitch_mm


def levels(share_of_white: FloatArray, gamma: float) -> NDArray[np.uint8]:
    """Return the eight-bit levels that show shares of white, shape (H, W), of 0 to 1."""
    return np.rint(255.0 * np.clip(share_of_white, 0.0, 1.0) ** (1.0 / gamma)).astype(np.uint8)


def share_shown(level: NDArray[np.uint8], panel: Panel) -> FloatArray:
    """Return the share of white that levels shine with, black included, shape (H, W)."""
    black = 1.0 / panel.contrast
    return np.asarray(black + (1.0 - black) * (level / 255.0) ** panel.gamma)


NEAR_MM, FAR_MM = 1.0, 1e4
FINE = 4
"""Samples per camera pixel and axis; an even panel then differs by 0.2 % from eight, below the detector noise of 1
%."""


def bench_scene(panel: Panel, share: FloatArray, panel_at: BenchPose, camera: CameraModel, camera_at: BenchPose) -> Any:
    """Return the loaded Mitsuba scene, in millimetres; keep it while its renders are used.

    ``share``: shape (H, W), of white, per panel pixel; ``camera``: undistorted pinhole.
    """
    half_width, half_height = (0.5 * v for v in panel.size_mm)
    away_mm = float(np.linalg.norm(panel_at.r_bench_mm - camera_at.r_bench_mm))
    fine = finer(camera)
    square_px = away_mm / fine.fx / panel.pitch_mm
    to_world = np.eye(4)
    # Mitsuba's rectangle is a square of half side 1 with its normal along z; the lit side looks back to the camera.
    to_world[:3, :3] = panel_at.bench_from_body @ np.diag([half_width, -half_height, -1.0])
    to_world[:3, 3] = panel_at.r_bench_mm
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 1},
        "panel": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(to_world.tolist()),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
            "emitter": {"type": "area", "radiance": emission(panel, share, square_px)},
        },
        "sensor": pinhole(fine, camera_at.r_bench_mm, camera_at.bench_from_body, NEAR_MM, FAR_MM)
        | {"sampler": {"type": "stratified", "sample_count": 1, "jitter": False}},
    }
    return mi.load_dict(scene)


def finer(camera: CameraModel) -> CameraModel:
    """Return the same lens in front of ``FINE`` times as many pixels each way."""
    return replace(
        camera,
        width=camera.width * FINE,
        height=camera.height * FINE,
        fx=camera.fx * FINE,
        fy=camera.fy * FINE,
        # the image's outer edge, not the first pixel's centre, stays where it is
        cx=(camera.cx + 0.5) * FINE - 0.5,
        cy=(camera.cy + 0.5) * FINE - 0.5,
    )


def render(scene: Any, blur_px: float) -> NDArray[np.float32]:
    """Return the radiance in every pixel [W m-2 sr-1], shape (H, W), of a scene of :func:`bench_scene`.

    ``blur_px``: standard deviation of the lens's Gaussian blur, in pixels of the camera.
    """
    fine = np.array(mi.render(scene, spp=1))[..., 0]
    if blur_px > 0.0:
        fine = cv2.GaussianBlur(fine, (0, 0), blur_px * FINE, borderType=cv2.BORDER_REPLICATE)
    height, width = fine.shape[0] // FINE, fine.shape[1] // FINE
    return np.ascontiguousarray(fine.reshape(height, FINE, width, FINE).mean(axis=(1, 3)))


def emission(panel: Panel, share: FloatArray, square_px: float) -> Any:
    """Return the texture of the panel's emission: see :mod:`horizonval.systems.b.rig.scene`.

    ``square_px``: side of the square over which stripes and rows are averaged, in panel pixels.
    """

    class Emission(mi.Texture):
        def __init__(self) -> None:
            super().__init__(mi.Properties("panel_emission"))
            self.share = mi.Float(np.asarray(share, dtype=np.float32).ravel())
            # A number of the kernel's data, not of its code, serves all frames with one kernel.
            self.white = dr.opaque(mi.Float, panel.white_w_m2_sr, 1)
            self.half = dr.opaque(mi.Float, 0.5 * square_px, 1)

        def eval(self, si: Any, active: Any = True) -> Any:
            column, row = si.uv.x * panel.width, (1.0 - si.uv.y) * panel.height
            if panel.smooth:
                light = self._between(column - 0.5, row - 0.5, active)
            else:
                light = self._level(dr.floor(column), dr.floor(row), active) * _matrix(panel, column, row, self.half)
            light *= _backlight(panel, si.uv.x, si.uv.y)
            seen = dr.power(dr.maximum(mi.Frame3f.cos_theta(si.wi), 0.0), panel.viewing_power)
            return mi.UnpolarizedSpectrum(self.white * light * seen)

        def _level(self, column: Any, row: Any, active: Any) -> Any:
            i = dr.clip(mi.Int32(column), 0, panel.width - 1)
            j = dr.clip(mi.Int32(row), 0, panel.height - 1)
            return dr.gather(mi.Float, self.share, mi.UInt32(j * panel.width + i), active)

        def _between(self, column: Any, row: Any, active: Any) -> Any:
            x, y = dr.floor(column), dr.floor(row)
            right, down = column - x, row - y
            upper = dr.lerp(self._level(x, y, active), self._level(x + 1, y, active), right)
            lower = dr.lerp(self._level(x, y + 1, active), self._level(x + 1, y + 1, active), right)
            return dr.lerp(upper, lower, down)

        def is_spatially_varying(self) -> bool:
            return True

        def mean(self) -> Any:
            return mi.Float(float(np.mean(share)) * panel.white_w_m2_sr)

        def to_string(self) -> str:
            return f"Emission[{panel}]"

    return Emission()


def _matrix(panel: Panel, column: Any, row: Any, half: Any) -> Any:
    """Return what stripes and rows leave of the light, mean over a square of half side ``half``; 1 over a pixel."""
    stripes = _running_stripes(panel, column + half) - _running_stripes(panel, column - half)
    rows = _running_rows(panel, row + half) - _running_rows(panel, row - half)
    return stripes * rows / dr.square(2.0 * half)


def _running_stripes(panel: Panel, column: Any) -> Any:
    """Return the light of a row from its start to a place, in pixels' lights."""
    across = 3.0 * (column - dr.floor(column))
    total = dr.floor(column)
    for k, share in enumerate(panel.stripe_share):
        total += share * dr.clip((across - k - 0.5) / panel.stripe_open + 0.5, 0.0, 1.0)
    return total


def _running_rows(panel: Panel, row: Any) -> Any:
    return dr.floor(row) + dr.clip((row - dr.floor(row) - 0.5) / panel.row_open + 0.5, 0.0, 1.0)


def _backlight(panel: Panel, u: Any, v: Any) -> Any:
    x, y = 2.0 * u - 1.0, 2.0 * v - 1.0
    return 1.0 - panel.backlight_fall * 0.5 * (x * x + y * y) - panel.backlight_slope * u
