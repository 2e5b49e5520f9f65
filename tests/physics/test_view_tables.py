"""View tables against the march along every cell with four times the nodes, over suns, heights, lenses, air and ground.

Pixels brighter than 1e-3 of the frame's brightest, by day; down to 1e-4 in twilight. Hundreds of cases drawn at random
are in ``test_view_tables_at_random``.
"""

from __future__ import annotations

from typing import Any

import pytest
from table_and_march import (
    BLUE,
    DAY_FLOOR,
    DAY_MEDIAN,
    DAY_WORST,
    GREEN,
    NIR,
    RED,
    TWILIGHT_FLOOR,
    TWILIGHT_WORST,
    angle_of_limb_deg,
    camera_of,
    scene_of,
    table_errors,
)

from horizonval.renderer.backend import activate
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

Case = tuple[SceneSpec, CameraSpec]

LIMB = angle_of_limb_deg(500.0)
BARREL = [-0.12, 0.03, 4e-4, -3e-4, -0.004]
SKY = {"projection": "fisheye", "fov_deg": 230.0, "image_circle_deg": 230.0}


def _sunlit(tilt_deg: float = LIMB, **tables: Any) -> SceneSpec:
    return scene_of(50.0, off_nadir_deg=tilt_deg, **tables)


DAY: dict[str, Case] = {
    "sun in the zenith": (scene_of(0.0), camera_of(GREEN, NIR)),
    "sun at 60 deg": (scene_of(60.0, azimuth_deg=-40.0), camera_of(GREEN, NIR)),
    "sun at 85 deg, ahead": (scene_of(85.0), camera_of(GREEN, NIR)),
    "sun at 85 deg, behind": (scene_of(85.0, azimuth_deg=180.0), camera_of(BLUE)),
    "straight down": (_sunlit(0.0), camera_of(GREEN)),
    "limb upside down": (_sunlit(LIMB, camera={"mount_yaw_deg": 180.0}), camera_of(GREEN)),
    "above the limb": (_sunlit(LIMB + 20.0), camera_of(GREEN)),
    "300 km": (scene_of(40.0, 300.0), camera_of(RED, fov_deg=70.0)),
    "20 200 km": (scene_of(70.0, 20_200.0, off_nadir_deg=8.0), camera_of(GREEN, fov_deg=14.0)),
    "geostationary": (scene_of(30.0, 35_786.0, off_nadir_deg=0.0), camera_of(GREEN, fov_deg=19.0)),
    "sphere": (_sunlit(earth={"shape": "sphere", "radius_km": 6371.0}), camera_of(GREEN)),
    "barrel": (_sunlit(), camera_of(GREEN, width=80, height=60, distortion=BARREL)),
    "whole sky": (_sunlit(0.0), camera_of(GREEN, width=96, height=96, **SKY)),
    "half a degree": (_sunlit(LIMB + 0.5), camera_of(GREEN, fov_deg=0.5)),
    "clouds": (_sunlit(LIMB - 15.0, clouds={"cover": 0.5}), camera_of(GREEN)),
    "land and sea": (_sunlit(30.0, surface={"kind": "earth"}), camera_of(GREEN, NIR)),
    "glint under clouds": (
        scene_of(30.0, off_nadir_deg=28.0, surface={"kind": "earth"}, clouds={"cover": 0.3}),
        camera_of(NIR, fov_deg=90.0),
    ),
    "black ground": (_sunlit(surface={"albedo": 0.0}), camera_of(GREEN)),
    "single scattering": (_sunlit(render={"orders": "single"}), camera_of(BLUE, NIR)),
    "haze": (_sunlit(atmosphere={"aerosol": "background"}, render={"orders": "single"}), camera_of(GREEN, NIR)),
    "haze, all orders": (_sunlit(atmosphere={"aerosol": "background"}), camera_of(GREEN)),
    "volcanic air towards the sun": (
        scene_of(75.0, atmosphere={"aerosol": "volcanic_high"}, render={"orders": "single"}),
        camera_of(NIR),
    ),
    "refraction": (_sunlit(atmosphere={"refraction": True}), camera_of(GREEN)),
    "refraction through a narrow field": (
        _sunlit(LIMB + 0.5, atmosphere={"refraction": True}),
        camera_of(GREEN, fov_deg=3.0),
    ),
    "refraction, clouds and coasts": (
        _sunlit(LIMB - 15.0, atmosphere={"refraction": True}, clouds={"cover": 0.5}, surface={"kind": "earth"}),
        camera_of(GREEN),
    ),
    "inside the air": (scene_of(60.0, 20.0, off_nadir_deg=85.0), camera_of(GREEN)),
    "over the pole": (_sunlit(0.0, platform={"latitude_deg": 90.0}), camera_of(GREEN, fov_deg=130.0)),
    "across the date line": (
        _sunlit(30.0, platform={"latitude_deg": -3.0, "longitude_deg": 180.0}, surface={"kind": "earth"}),
        camera_of(GREEN, fov_deg=90.0),
    ),
    "one pixel, and a wide band": (
        _sunlit(0.0),
        camera_of(
            GREEN, {"name": "wide", "kind": "solar", "lo_um": 0.45, "hi_um": 0.75, "nodes": 5}, width=1, height=1
        ),
    ),
    "no air": (_sunlit(atmosphere={"profile": "none"}), camera_of(GREEN)),
    "sun in frame": (
        scene_of(80.0, off_nadir_deg=96.0, sun_azimuth_deg=0.0),
        camera_of(GREEN),
    ),
}

TWILIGHT: dict[str, Case] = {
    "sun at 88 deg": (scene_of(88.0), camera_of(GREEN, fov_deg=40.0)),
    "sun at 92 deg, across": (scene_of(92.0, azimuth_deg=95.0), camera_of(GREEN, NIR, fov_deg=40.0)),
    "sun at 96 deg": (scene_of(96.0), camera_of(GREEN, NIR, fov_deg=40.0)),
    "sun at 96 deg, from far": (scene_of(96.0, 35_786.0, off_nadir_deg=5.0), camera_of(GREEN, fov_deg=12.0)),
    "sun at 100 deg, off": (scene_of(100.0, azimuth_deg=30.0), camera_of(BLUE, fov_deg=40.0)),
    "sun at 104 deg": (scene_of(104.0), camera_of(RED, fov_deg=40.0)),
    "sun at 108 deg": (scene_of(108.0, azimuth_deg=8.0), camera_of(GREEN, fov_deg=40.0)),
    "single scattering": (scene_of(95.0, render={"orders": "single"}), camera_of(GREEN, fov_deg=40.0)),
    "haze": (
        scene_of(93.0, atmosphere={"aerosol": "background"}, render={"orders": "single"}),
        camera_of(GREEN, fov_deg=40.0),
    ),
    "clouds and land": (
        scene_of(90.0, azimuth_deg=60.0, clouds={"cover": 0.5}, surface={"kind": "earth"}),
        camera_of(GREEN),
    ),
    "refraction": (scene_of(94.0, atmosphere={"refraction": True}), camera_of(GREEN, fov_deg=40.0)),
    "refraction and clouds": (
        scene_of(94.0, azimuth_deg=20.0, atmosphere={"refraction": True}, clouds={"cover": 0.5}),
        camera_of(GREEN, fov_deg=40.0),
    ),
    "whole sky": (scene_of(97.0, off_nadir_deg=0.0), camera_of(GREEN, width=96, height=96, **SKY)),
    "moonlit clouds": (
        scene_of(150.0, off_nadir_deg=45.0, moon={"zenith_deg": 20.0, "azimuth_deg": 200.0}, clouds={"cover": 0.4}),
        camera_of(GREEN),
    ),
    "airglow": (scene_of(160.0, moon={"enabled": False}, off_nadir_deg=LIMB + 4.0), camera_of(GREEN, fov_deg=20.0)),
    "moon in frame": (
        scene_of(140.0, moon={"zenith_deg": 100.0, "azimuth_deg": 80.0}, off_nadir_deg=78.0),
        camera_of(GREEN),
    ),
}


@pytest.fixture(scope="module", autouse=True)
def _backend() -> None:
    activate()


SLOW = {
    "haze, all orders",
    "300 km",
    "sun at 85 deg, behind",
    "one pixel, and a wide band",
    "sun in the zenith",
    "glint under clouds",
    "sun at 60 deg",
    "sphere",
    "clouds",
    "land and sea",
    "sun at 104 deg",
    "sun at 100 deg, off",
    "refraction, clouds and coasts",
    "moonlit clouds",
    "moon in frame",
    "sun at 85 deg, ahead",
    "across the date line",
    "clouds and land",
}
"""Whose table of multiple scattering takes a minute to solve, others that take half of one, and some of many alike."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in DAY])
def test_by_day(name: str) -> None:
    errors = table_errors(*DAY[name], DAY_FLOOR)
    assert errors
    assert all(e.worst < DAY_WORST and e.median < DAY_MEDIAN for e in errors), "; ".join(map(str, errors))


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in TWILIGHT])
def test_in_twilight_and_by_night(name: str) -> None:
    errors = table_errors(*TWILIGHT[name], TWILIGHT_FLOOR)
    assert errors
    assert all(e.worst < TWILIGHT_WORST for e in errors), "; ".join(map(str, errors))
