"""Kernels: right to rounding in double precision, and shared by scenes. One costs up to a second to compile."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import special

import horizonval
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

activate()

import drjit as dr  # noqa: E402

from horizonval.renderer.tables import vectors  # noqa: E402

VISIBLE = [{"name": "v", "kind": "solar", "nodes": 4, "lo_um": a, "hi_um": b} for a, b in ((0.45, 0.75), (0.5, 0.65))]
INFRARED = [{"name": "i", "kind": "thermal", "lo_um": a, "hi_um": b} for a, b in ((14.0, 16.0), (13.5, 15.0))]
ONCE = {"render": {"orders": "single"}}
LENS = {"width": 96, "height": 64, "fov_deg": 60.0, "distortion": [-0.12, 0.03, 4e-4, -3e-4, -0.004]}
OTHER_LENS = {"width": 80, "height": 90, "fov_deg": 70.0, "distortion": [-0.1, 0.02, 1e-4, 1e-4, -0.001]}
CLOUDS = {"surface": {"kind": "earth"}, "clouds": {"cover": 0.5}} | ONCE
OTHER_CLOUDS = {"surface": {"kind": "earth"}, "clouds": {"cover": 0.7, "top_km": 9.0}} | ONCE
CLIMATES = {"atmosphere": {"profile": "by_latitude_month"}} | ONCE
"""Two scenes see different numbers of rows of latitude."""


def _kernels(changes: Mapping[str, Any], band: Mapping[str, Any], geometry: Mapping[str, Any]) -> dict[str, float]:
    """Return the kernels that a frame launches, by their hashes, with their operations."""
    scene: dict[str, Any] = {"camera": {"file": "test", "mount_roll_deg": 65.0}, **changes}
    camera = {"camera": dict(geometry), "band": [dict(band)]}
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        render_frame(SceneSpec.model_validate(scene), CameraSpec.model_validate(camera))
        history = dr.kernel_history()
    return {str(k["hash"]): k["operation_count"] for k in history if k["type"] == dr.KernelType.JIT}


@pytest.mark.parametrize(
    ("band", "other_band", "changes", "other_changes", "most", "marches"),
    [
        (*VISIBLE, ONCE, ONCE, 55, 1),
        pytest.param(*VISIBLE, {}, {}, 55, 1, marks=pytest.mark.slow),
        # two marches by day, and two with pieces on either side of the shadow's edge
        pytest.param(*VISIBLE, CLOUDS, OTHER_CLOUDS, 80, 4, marks=pytest.mark.slow),
        (*INFRARED, {}, {}, 50, 0),
        pytest.param(*VISIBLE, CLIMATES, CLIMATES, 55, 1, marks=pytest.mark.slow),
    ],
    ids=["air", "all orders", "clouds", "thermal", "climates"],
)
def test_another_scene_of_the_kind_compiles_nothing(
    band: dict[str, Any],
    other_band: dict[str, Any],
    changes: dict[str, Any],
    other_changes: dict[str, Any],
    most: int,
    marches: int,
) -> None:
    """Another altitude, place, Sun, climate, band, lens and size: the kernels are those of the first frame."""
    first = {
        "platform": {"altitude_km": 500.0, "latitude_deg": 20.0, "epoch_utc": "2026-03-20T12:00:00Z"},
        "sun": {"zenith_deg": 50.0, "azimuth_deg": 40.0},
        "atmosphere": {"profile": "us_standard"},
    }
    second = {
        "platform": {"altitude_km": 700.0, "latitude_deg": -35.0, "epoch_utc": "2026-07-01T12:00:00Z"},
        "sun": {"zenith_deg": 60.0, "azimuth_deg": -70.0},
        "atmosphere": {"profile": "subarctic_winter"},
    }
    known = _kernels({**first, **changes}, band, LENS)
    assert 0 < len(known) <= most
    # with the shadow's edge in view some rays are marched, as some always may be; from another place none
    known |= _kernels({**first, **changes, "sun": {"zenith_deg": 91.0, "azimuth_deg": 40.0}}, band, LENS)
    known |= _kernels({**first, **changes, "platform": {**first["platform"], "latitude_deg": -60.0}}, band, LENS)
    others = _kernels({**second, **other_changes}, other_band, OTHER_LENS)
    assert {name: size for name, size in others.items() if name not in known} == {}
    assert sum(size > 3000 for size in known.values()) <= marches


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


ANY = np.random.default_rng(1).uniform(-30.0, 30.0, 4001)
POSITIVE = np.exp(ANY)
SHARE = np.tanh(0.2 * ANY)


@pytest.mark.parametrize(
    ("name", "at", "exact"),
    [
        ("sqrt", POSITIVE, np.sqrt),
        ("sin", ANY, np.sin),
        ("cos", ANY, np.cos),
        ("exp", ANY, np.exp),
        ("log", POSITIVE, np.log),
        ("asin", SHARE, np.arcsin),
        ("acos", SHARE, np.arccos),
        ("atan", ANY, np.arctan),
        ("erf", ANY, special.erf),
    ],
)
def test_functions_are_right_to_rounding(name: str, at: np.ndarray, exact: Callable[[Any], np.ndarray]) -> None:
    """1e-14 of the value, and 4e-15 beside it where a function crosses zero: 1e-9 arcsec of an angle."""
    activate()
    import drjit as dr
    import mitsuba as mi

    found = np.array(getattr(dr, name)(mi.Float64(at)))
    np.testing.assert_allclose(found, exact(at), rtol=1e-14, atol=4e-15)


def test_the_inverse_root_is_that_of_numpy_bit_by_bit() -> None:
    activate()
    import mitsuba as mi

    from horizonval.renderer.types import inverse_root

    assert np.array_equal(np.array(inverse_root(mi.Float64(POSITIVE))), 1.0 / np.sqrt(POSITIVE))


def test_nothing_takes_what_is_coarse_on_a_gpu() -> None:
    """Right to 1e-6 there in double precision, as measured; ``dr.normalize`` divides by such a root."""
    coarse = re.compile(r"\bdr\.(rsqrt|rcp|tan|sinh|cosh|tanh|normalize)\((?!.*mi\.Vector3f)")
    sources = sorted(Path(horizonval.__file__).parent.rglob("*.py"))
    assert len(sources) > 300
    assert [str(p) for p in sources if coarse.search(p.read_text(encoding="utf-8"))] == []
