"""Frames with whole pixels against frames with every pixel cut into cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np
import pytest

from horizonval.renderer.backend import activate
from horizonval.renderer.kernel.cells import Cells, group_cells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

SOLAR = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
THERMAL = {"name": "lwir", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}
DISC = {"width": 480, "height": 480, "fov_deg": 18.0, "projection": "equal_angle"}
LENS = {"width": 320, "height": 320, "fov_deg": 60.0, "distortion": [-0.12, 0.03, 4e-4, -3e-4, -0.004]}

COASTS = {
    "surface": {"kind": "earth"},
    "platform": {"altitude_km": 500.0, "latitude_deg": 40.0, "longitude_deg": 15.0},
    "camera": {"mount_roll_deg": 55.0},
    "geometry": {"width": 320, "height": 320, "fov_deg": 40.0},
}


def specs(changes: Mapping[str, Any], method: str, band: dict[str, Any] = SOLAR) -> tuple[SceneSpec, CameraSpec]:
    """A limb across a square frame of 60 deg, 320 pixels wide, seen from 500 km at noon, with changes."""
    scene: dict[str, Any] = {
        "camera": {"file": "test", "mount_roll_deg": 65.0},
        "platform": {"altitude_km": 500.0, "latitude_deg": 20.0},
        "sun": {"zenith_deg": 50.0, "azimuth_deg": 40.0},
        "render": {"method": method, "orders": "single", "nodes": 128},
    }
    geometry = {"width": 320, "height": 320, "fov_deg": 60.0}
    for key, table in changes.items():
        if key == "geometry":
            geometry = table
        else:
            scene[key] = scene.get(key, {}) | table
    return SceneSpec.model_validate(scene), CameraSpec.model_validate({"camera": geometry, "band": [band]})


def opened(changes: Mapping[str, Any], every_cell: bool, band: dict[str, Any] = SOLAR) -> tuple[Any, FrameGeometry]:
    """The integrator and the geometry of a frame."""
    activate()
    from horizonval.renderer.description import describe
    from horizonval.renderer.plugins import mitsuba_scene

    described = describe(*specs(changes, "march", band))
    scene = mitsuba_scene(described.limb, described.sensor)
    integrator = scene.integrator()
    return integrator, replace(integrator.apparent_view(scene.sensors()[0]), every_cell=every_cell)


def marched(changes: Mapping[str, Any], every_cell: bool, band: dict[str, Any] = SOLAR) -> np.ndarray:
    """A frame without view tables."""
    integrator, view = opened(changes, every_cell, band)
    from horizonval.renderer.image import render_bands

    made, settings = integrator.prepared, integrator.settings
    radiance, _ = render_bands(view, made.batches, integrator.bands, settings.nodes, made.thermal, made.model.emission)
    return np.array(radiance[band["name"]]).reshape(view.height, view.width)


def grouped(changes: Mapping[str, Any], every_cell: bool) -> Cells:
    """The grouped cells of a frame."""
    return group_cells(opened(changes, every_cell)[1])


def coverage(cells: Cells) -> np.ndarray:
    """The share of every pixel that the Earth covers."""
    import mitsuba as mi

    covered = dr.zeros(mi.Float64, cells.count)
    dr.scatter_add(covered, cells.ground.share, cells.ground.slot)
    return np.array(cells.image(covered))


FRAMES: dict[str, tuple[Mapping[str, Any], dict[str, Any], float]] = {
    "noon": ({}, SOLAR, 0.6),
    "aerosol": ({"atmosphere": {"aerosol": "volcanic_high"}}, SOLAR, 0.6),
    "lens": ({"geometry": LENS}, SOLAR, 0.6),
    "low Sun": ({"sun": {"zenith_deg": 80.0, "azimuth_deg": 0.0}, "camera": {"mount_roll_deg": 40.0}}, SOLAR, 0.9),
    "geostationary": (
        {"platform": {"altitude_km": 35_786.0}, "camera": {"mount_roll_deg": 0.0}, "geometry": DISC},
        SOLAR,
        0.9,
    ),
    "coasts and glint": (COASTS, SOLAR, 0.6),
    "thermal": ({}, THERMAL, 0.6),
    "warm and cold ground": (COASTS, THERMAL, 0.6),
}
"""Changes, band, and the share of the cells' rays that is left at most."""
SLOW = ("lens", "low Sun", "geostationary")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in FRAMES])
def test_a_whole_pixel_is_as_good_as_its_cells(name: str) -> None:
    """Worst 1e-4, median 1e-5, of fewer rays; and the pixels that are cut are the same to the last bit."""
    changes, band, rays = FRAMES[name]
    image, reference = (marched(changes, every_cell, band) for every_cell in (False, True))
    bright = reference > 1e-3 * reference.max()
    error = np.abs(image - reference)[bright] / reference[bright]
    assert error.max() < 1e-4
    assert np.median(error) < 1e-5
    few, all_cut = grouped(changes, False), grouped(changes, True)
    assert few.ground.count + few.limb.count < rays * (all_cut.ground.count + all_cut.limb.count)
    if band is THERMAL:
        cut = np.array(few.kinds.cut)
        assert np.array_equal(image.ravel()[cut], reference.ravel()[cut])


@pytest.mark.parametrize("name", ["noon", "lens"])
def test_coverage_knows_no_whole_pixels(name: str) -> None:
    changes, _, _ = FRAMES[name]
    assert np.array_equal(coverage(grouped(changes, False)), coverage(grouped(changes, True)))


NARROW = {"width": 24, "height": 20, "fov_deg": 2.0}


@pytest.mark.parametrize("roll_deg", [0.0, 180.0], ids=["ground", "space"])
def test_a_frame_without_an_edge_has_no_cells(roll_deg: float) -> None:
    changes = {"camera": {"mount_roll_deg": roll_deg}, "geometry": NARROW}
    cells = grouped(changes, False)
    assert cells.count == 480
    assert cells.ground.count == (480 if roll_deg == 0.0 else 0)
    image, reference = (marched(changes, every_cell) for every_cell in (False, True))
    assert image == pytest.approx(reference, rel=1e-6)


@pytest.mark.parametrize("longitude_deg", [20.0, -150.0], ids=["land", "sea"])
def test_a_frame_of_land_or_sea_alone_has_no_coast_to_cut(longitude_deg: float) -> None:
    place = {"altitude_km": 500.0, "latitude_deg": 20.0, "longitude_deg": longitude_deg}
    down = {"camera": {"mount_roll_deg": 0.0}, "geometry": NARROW, "surface": {"kind": "earth"}, "platform": place}
    cells = grouped(down, False)
    assert cells.count == cells.ground.count == 480


def test_pixels_at_the_sun_are_cut() -> None:
    """The Sun's light in the frame is the same to rounding, also with a sky behind."""
    changes = {
        "camera": {"mount_roll_deg": 180.0},
        "sun": {"zenith_deg": 5.0, "azimuth_deg": 30.0},
        "geometry": {"width": 60, "height": 40, "fov_deg": 20.0},
    }
    image, reference = (marched(changes, every_cell) for every_cell in (False, True))
    assert reference.max() > 1e6 * np.median(reference)
    assert np.array_equal(image, reference)


def test_a_camera_that_sees_only_space_has_a_dark_frame() -> None:
    activate()
    from horizonval.renderer.frame import render_in_turn

    away = {"camera": {"mount_roll_deg": 150.0}, "geometry": {"width": 16, "height": 16, "fov_deg": 30.0}}
    assert not render_in_turn(*specs(away, "table")).radiance["vis"].any()
