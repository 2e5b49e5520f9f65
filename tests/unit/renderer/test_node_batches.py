"""Node batches and their march: closed forms of uniform air, one type per kind of source; kernels that scenes share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from horizonval.renderer.backend import activate

activate()
import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from horizonval.renderer.kernel.march import march, optical_depth  # noqa: E402
from horizonval.renderer.kernel.node_batches import GlowNodes, OpacityNodes, Place, SolarNodes  # noqa: E402
from horizonval.renderer.planet import Planet  # noqa: E402
from horizonval.renderer.tables import AltitudeGrid, SunTable, table_of, vectors  # noqa: E402
from horizonval.renderer.types import constant  # noqa: E402

RADIUS_M, TOP_M, K = 6.4e6, 1e5, 1.2e-5
PLANET = Planet(RADIUS_M, RADIUS_M)
ALTITUDE_M = np.linspace(0.0, TOP_M, 11)
GRID = AltitudeGrid.of(ALTITUDE_M)
NODES = 128


def _uniform(value: float) -> mi.Float64:
    return table_of(mi.Float64, np.full(len(ALTITUDE_M), value))


def _vec(*values: float) -> Any:
    return tuple(mi.Float64(v) for v in values)


UPWARDS = _vec(0.0, 0.0, RADIUS_M), _vec(0.0, 0.0, 1.0)
SUN = _vec(0.0, 0.0, 1.0)


def _march(batch: Any) -> tuple[float, float]:
    radiance, transmittance = march(PLANET, TOP_M, batch, *UPWARDS, SUN, mi.Bool(False), NODES, 0.5)
    return float(radiance[0][0]), float(transmittance[0][0])


def test_opacity_alone_is_the_column() -> None:
    batch = OpacityNodes(1, GRID, _uniform(K))
    depth = optical_depth(PLANET, TOP_M, batch, *UPWARDS, NODES, 0.5)
    assert float(depth[0][0]) == pytest.approx(K * TOP_M, rel=1e-9)
    place = Place.of(PLANET, GRID, *UPWARDS, mi.Float64(10.0))
    assert batch.source_at(place, batch.extinction_at(place)) == []


def test_airglow_adds_up_per_metre_and_needs_no_extinction() -> None:
    radiance, transmittance = _march(GlowNodes(1, GRID, _uniform(0.0), _uniform(3e-6), [constant(0.0)], 0.0))
    assert transmittance == 1.0
    assert radiance == pytest.approx(3e-6 * TOP_M, rel=1e-6)


def test_sunlight_is_scattered_once_by_thin_air() -> None:
    """Isotropic scatterers below an overhead Sun, looked at upwards: albedo times irradiance over 4 pi."""
    thin = 1e-10
    height, mu = SunTable.nodes(8, 8, RADIUS_M, TOP_M)
    table = SunTable(table_of(mi.Float64, np.full(mu.size, np.log(1e-12))), 8, 8, RADIUS_M, TOP_M)
    assert height[-1] == TOP_M
    batch = SolarNodes(
        1, GRID, _uniform(2.0 * thin), _uniform(thin), [constant(0.0)], None, [constant(7.0)], [constant(0.0)], table
    )
    radiance, _ = _march(batch)
    assert radiance == pytest.approx(thin * TOP_M * 7.0 / (4.0 * np.pi), rel=1e-4)


def test_kernels_do_not_depend_on_where_numpy_puts_an_array() -> None:
    """Dr.Jit reads NumPy's memory in place, and makes a kernel for every alignment; rows are copied to one."""
    room = np.zeros(3 * 64 + 8)
    hashes = set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for first in range(8):
            dr.kernel_history_clear()
            x, y, z = vectors(room[first : first + 3 * 64].reshape(64, 3))
            dr.eval(x * y + z)
            hashes |= {kernel["hash"] for kernel in dr.kernel_history([dr.KernelType.JIT])}
    assert len(hashes) == 1
