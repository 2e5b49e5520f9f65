"""Sunlight through two airs side by side, against a plain sum that shares no code with the renderer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from side_by_side import NORTH, RADIUS_M, SOUTH, TOP_M, scattered_once

from horizonval.earth.column import ColumnPlaces, OpticalModel, SpectralNode
from horizonval.earth.weather.field import ColumnMap
from horizonval.renderer.backend import activate

activate()
import mitsuba as mi  # noqa: E402

from horizonval.renderer.kernel.batching import IMAGE_TABLE, make_batches  # noqa: E402
from horizonval.renderer.kernel.march import march  # noqa: E402
from horizonval.renderer.planet import Planet  # noqa: E402
from horizonval.renderer.tables import vectors  # noqa: E402

PLANET = Planet(RADIUS_M, RADIUS_M)

ALTITUDE_M = np.linspace(0.0, TOP_M, 1001)
LEVEL_M = np.linspace(0.0, TOP_M, 201)
ROWS = np.arange(40, 91) / 100.0


def north_of_a_border(normal: Any) -> Any:
    """Return a share that rises from 0 to 1 between two latitudes, 37 and 44 deg."""
    return np.clip((normal[..., 2] - 0.60) / 0.10, 0.0, 1.0)


def along_a_slope(normal: Any) -> Any:
    """Return a share that falls from west to east and rises to the north."""
    return np.clip(0.5 - 1.2 * normal[..., 1] + 0.6 * (normal[..., 2] - 0.64), 0.0, 1.0)


def _model(share: Any, places: ColumnPlaces | None) -> OpticalModel:
    """Return the model whose own column is that of ``share`` 0, with columns of shares (m,) north air."""
    molecules, absorption = SOUTH.molecules(ALTITUDE_M), SOUTH.absorption(ALTITUDE_M)
    zero = np.zeros_like(ALTITUDE_M)
    node = SpectralNode(
        name="n", band="b", weight=1.0, wavelength_um=0.55,
        extinction_per_m=molecules + absorption, molecular_per_m=molecules, molecular_cos2=0.75,
        particle_per_m=zero, asymmetry=zero, solar_irradiance=1.0, sun_radiance=0.0,
    )  # fmt: skip
    if places is not None:
        more = np.asarray(share)[:, None] * (NORTH.molecules(LEVEL_M) - SOUTH.molecules(LEVEL_M))
        absorbed = np.asarray(share)[:, None] * (NORTH.absorption(LEVEL_M) - SOUTH.absorption(LEVEL_M))
        node = replace(node, more_extinction_per_m=more + absorbed, more_molecular_per_m=more)
    return OpticalModel(ALTITUDE_M, TOP_M, (node,), albedo=0.0, columns=places)


def _rays(azimuths_deg: Any, heights_m: Any) -> tuple[Any, Any, Any]:
    """Return a camera 500 km above 40 N, and directions that pass the ground at heights under azimuths."""
    latitude = np.radians(40.0)
    up = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    north, east = np.array([-np.sin(latitude), 0.0, np.cos(latitude)]), np.array([0.0, 1.0, 0.0])
    azimuth, height = (v.ravel() for v in np.meshgrid(np.radians(azimuths_deg), heights_m, indexing="ij"))
    sine = (RADIUS_M + height) / (RADIUS_M + 5e5)
    level = np.cos(azimuth)[:, None] * north + np.sin(azimuth)[:, None] * east
    d = sine[:, None] * level - np.sqrt(1.0 - sine**2)[:, None] * up
    return (RADIUS_M + 5e5) * up, d, np.stack([north, east, up])


AZIMUTHS_DEG = (0.0, 80.0, 180.0, 270.0)
HEIGHTS_M = (8e3, 15e3, 22e3, 30e3, 45e3, 70e3)


def _sun(axes: Any, zenith_deg: float, azimuth_deg: float) -> Any:
    zenith, azimuth = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)]) @ axes


def _marched(batch: Any, o: Any, d: Any, sun: Any) -> Any:
    rays, light = vectors(d), vectors(sun[None, :])
    found, _ = march(PLANET, TOP_M, batch, vectors(o[None, :]), rays, light, mi.Bool(False), 512)
    return np.array(found[0])


@pytest.fixture(scope="module")
def over_rows() -> Any:
    """Return the batch of two airs over rows of latitude."""
    share = north_of_a_border(np.stack([ROWS, ROWS, ROWS], axis=-1))
    return next(make_batches(_model(share, ColumnPlaces(LEVEL_M, ROWS)), PLANET, IMAGE_TABLE))[1]


@pytest.fixture(scope="module")
def on_a_map() -> Any:
    """Return the batch of two airs in columns on a map, 3 deg apart."""
    o, _, _ = _rays((0.0,), (8e3,))
    columns = ColumnMap.around(o, np.radians(34.0), np.radians(3.0))
    places = ColumnPlaces(LEVEL_M, np.zeros(0), columns)
    return next(make_batches(_model(along_a_slope(columns.normals()), places), PLANET, IMAGE_TABLE))[1]


@pytest.mark.parametrize(
    ("zenith_deg", "azimuth_deg", "own", "every"),
    # the low Sun's light has come by way of two ratios of depths, and through air that is not that of its place
    [(30.0, 150.0, 1e-3, 1e-3), (88.0, 100.0, 3e-2, 4e-2)],
)
@pytest.mark.parametrize(("air", "share"), [("over_rows", north_of_a_border), ("on_a_map", along_a_slope)])
def test_scattered_once_between_two_airs(
    air: str,
    share: Any,
    zenith_deg: float,
    azimuth_deg: float,
    own: float,
    every: float,
    request: pytest.FixtureRequest,
) -> None:
    o, d, axes = _rays(AZIMUTHS_DEG, HEIGHTS_M)
    sun = _sun(axes, zenith_deg, azimuth_deg)
    found = _marched(request.getfixturevalue(air), o, d, sun)
    for own_column, bar in ((True, own), (False, every)):
        exact = np.array([scattered_once(o, each, sun, share, own_column=own_column) for each in d])
        bright = exact > 1e-3 * exact.max()
        assert np.sum(bright) > 0.6 * len(d)
        assert found[bright] == pytest.approx(exact[bright], rel=bar)


def test_one_column_is_not_enough() -> None:
    """The same rays through the own column alone: the bars above tell the two apart."""
    o, d, axes = _rays((0.0,), HEIGHTS_M)
    sun = _sun(axes, 30.0, 150.0)
    batch = next(make_batches(_model(None, None), PLANET, IMAGE_TABLE))[1]
    exact = np.array([scattered_once(o, each, sun, north_of_a_border, own_column=False) for each in d])
    assert np.all(np.abs(_marched(batch, o, d, sun) / exact - 1.0) > 0.01)
