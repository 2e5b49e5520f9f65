"""The shipped infrared scenes show what they are there for: frames against published values and ray integrals."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import horizonval.render  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.earth.brightness import brightness_temperature_k
from horizonval.earth.emission import EmittingBand
from horizonval.earth.land import is_land
from horizonval.earth.optical import optical_model
from horizonval.earth.profiles import profile
from horizonval.frame import Frame, Hit
from horizonval.geometry.camera import camera_from_spec, pixel_grid, unproject
from horizonval.geometry.ellipsoid import geodetic_from_itrs
from horizonval.geometry.frames import inverse, rotate
from horizonval.render.frame import render_frame
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.load import deep_merge, load_scene
from horizonval.spec.scene import SceneSpec

FloatArray = NDArray[np.float64]


def with_changes(name: str, width: int, height: int, fov_deg: float, **changes: Any) -> tuple[SceneSpec, CameraSpec]:
    """Return a shipped scene with some keys changed, one ray per pixel, seen by its camera with fewer pixels."""
    scene, camera = load_scene(name)
    geometry = camera.camera.model_copy(update={"width": width, "height": height, "fov_deg": fov_deg})
    tables = deep_merge(scene.model_dump(exclude_unset=True), {"render": {"subsamples": 1}, **changes})
    return SceneSpec.model_validate(tables), camera.model_copy(update={"camera": geometry})


@pytest.fixture(scope="module")
def rendered() -> Callable[..., Frame]:
    """Render a scene as :func:`with_changes` has it; the same one only once."""
    done: dict[str, Frame] = {}

    def render(*arguments: Any, **changes: Any) -> Frame:
        key = repr((arguments, changes))
        if key not in done:
            done[key] = render_frame(*with_changes(*arguments, **changes))
        return done[key]

    return render


def rays_itrs(frame: Frame) -> FloatArray:
    """Return the directions of all pixels' centres, shape (H, W, 3)."""
    camera = camera_from_spec(CameraSpec.model_validate(frame.truth.camera).camera)
    return rotate(inverse(frame.truth.q_cam_from_itrs), unproject(camera, pixel_grid(camera)))


def band_of(frame: Frame, name: str) -> Band:
    return next(b for b in CameraSpec.model_validate(frame.truth.camera).band if b.name == name)


def brightness_k(frame: Frame, band: str) -> FloatArray:
    return brightness_temperature_k(band_of(frame, band), frame.radiance[band])


def geodetic_deg(r_itrs: FloatArray) -> tuple[FloatArray, FloatArray]:
    latitude, longitude, _ = geodetic_from_itrs(r_itrs)
    return np.degrees(latitude), np.degrees(longitude)


# --- day and night ---


def test_carbon_dioxide_does_not_know_day_from_night(rendered: Callable[..., Frame]) -> None:
    day, night = (rendered(name, 48, 40, 24.0) for name in ("ir-day-side", "ir-night-side"))
    for band in ("co2", "co2-narrow"):
        air = day.maps["hit"] != Hit.SURFACE
        assert air.any()
        assert (day.radiance[band][air] == night.radiance[band][air]).all(), band


def test_land_has_its_day_in_the_window_and_the_sea_has_none(rendered: Callable[..., Frame]) -> None:
    day, night = (rendered(name, 48, 40, 24.0) for name in ("ir-day-side", "ir-night-side"))
    ground = np.array(day.truth.r_itrs) + rays_itrs(day) * day.maps["distance"][..., None].astype(float)
    seen = day.maps["hit"] == Hit.SURFACE
    latitude, longitude = geodetic_deg(np.where(seen[..., None], ground, day.truth.r_itrs))
    land = is_land(latitude, longitude) & seen
    swing = brightness_k(day, "window") - brightness_k(night, "window")
    print(land.sum(), (seen&~land).sum(), swing[land].min(), swing[land].max(), abs(swing[seen & ~land]).max())
    for b in ("co2","co2-narrow","lwir"):
        s = brightness_k(day, b) - brightness_k(night, b)
        print(b, abs(s[land]).max(), abs(s[seen&~land]).max())
