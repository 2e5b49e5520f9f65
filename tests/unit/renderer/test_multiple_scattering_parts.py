"""Parts of multiple scattering against closed forms, and the store of solved tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import sph_harm_y

from horizonval.earth.column import SpectralNode
from horizonval.renderer.backend import activate

activate()

import mitsuba as mi  # noqa: E402

from horizonval.renderer.scattering import multiple_scattering as solver  # noqa: E402
from horizonval.renderer.scattering.multiple_scattering import content_key, multiple_scattering, solve  # noqa: E402
from horizonval.renderer.scattering.shells import (  # noqa: E402
    SOLVED_TOGETHER,
    DiffuseField,
    MultipleScattering,
    Quality,
    cosines,
    pairs,
    polar_parts,
    shell_rays,
)
from horizonval.renderer.scattering.source_table import SourceTable  # noqa: E402
from horizonval.renderer.tables import SunTable  # noqa: E402

COARSE = Quality(6, 12, 4, 2, 2, 6, 4, 2, 8, 4, 4)
ALTITUDE_M = np.linspace(0.0, 1e5, 101)
PLANET_M = 6371e3


def test_harmonics_are_scipys() -> None:
    theta, phi = np.linspace(0.05, 3.1, 9), 0.7
    polar, azimuthal = polar_parts(8, np.cos(theta), np.sin(theta)), cosines(8, np.cos(phi))
    for n, m in pairs(8):
        norm = (-1) ** m * (math.sqrt(2.0) if m else 1.0)
        expected = norm * sph_harm_y(n, m, theta, phi).real
        np.testing.assert_allclose(polar[n, m] * azimuthal[m], expected, atol=1e-14)


def test_shell_rays_are_straight_and_lose_what_they_absorb() -> None:
    """Nodes lie on their rays to 1 um; a uniform shell transmits ``exp(-k length)`` to 5e-6 and absorbs the rest.

    To 2e-4 where the ray is all but level: there the square root of its rise bends most.
    """
    k = np.full_like(ALTITUDE_M, 2e-7)
    heights = 1e5 * np.linspace(0.0, 1.0, 7) ** 2
    rays = shell_rays(ALTITUDE_M, k, PLANET_M, heights, 10, 4, 24)
    start = rays.radius_m[:, None, None]
    along = start * rays.cosine[..., None] + rays.node_distance_m
    np.testing.assert_allclose(along, rays.node_up * rays.node_radius_m, atol=1e-6)
    across = start**2 * (1.0 - rays.cosine[..., None] ** 2)
    np.testing.assert_allclose(np.sqrt(along**2 + across), rays.node_radius_m, rtol=1e-14)
    np.testing.assert_allclose(rays.end_transmittance, np.exp(-2e-7 * rays.end_m), rtol=5e-6)
    absorbed = np.sum(rays.node_weight, axis=-1) * 2e-7
    np.testing.assert_allclose(absorbed, 1.0 - rays.end_transmittance, atol=2e-4)
    np.testing.assert_allclose(rays.solid_angle.sum(axis=1), 2.0, rtol=1e-14)
    assert (rays.end_m[0, 10:] == 0).all(), "the ground is under one's feet"


def _node(scale: float = 1.0) -> SpectralNode:
    air = scale * 1.2e-5 * np.exp(-ALTITUDE_M / 8e3)
    zero = np.zeros_like(air)
    return SpectralNode("n", "n", 1.0, 0.55, air, air, 0.75, zero, zero, 1.0, 0.0)


def _sun_table(nodes: Sequence[SpectralNode]) -> SunTable:
    h, mu = SunTable.nodes(24, 24, PLANET_M, 1e5)
    ground = np.zeros(SOLVED_TOGETHER)
    ground[: len(nodes)] = [node.extinction_per_m[0] for node in nodes]
    depth = ground * (8e3 * np.exp(-h / 8e3)[:, None] / np.maximum(mu, 0.05))[..., None]
    return SunTable(mi.Float64(np.log(depth + 1e-12).ravel()), 24, 24, PLANET_M, 1e5)


def _solved(node: SpectralNode, planet_m: float = PLANET_M) -> MultipleScattering:
    return multiple_scattering([node], ALTITUDE_M, planet_m, COARSE, _sun_table)[0]


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(solver, "_memory", type(solver._memory)())
    return tmp_path


def test_any_altered_bit_of_a_table_makes_it_anew(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the archive's headers (the number of a compression that nobody has), the arrays, its end and the seal."""
    shape, degree = (COARSE.n_height, COARSE.n_sun), solver.degree_of(_node(), COARSE)
    moments = np.ones((*shape, len(solver.pairs(degree))))
    fields = [DiffuseField(1e5, PLANET_M, degree, n * moments, np.full(shape[1], n)) for n in (1.0, 2.0)]
    solution = MultipleScattering(fields[0], fields[1], 0.25)
    calls: list[int] = []
    monkeypatch.setattr(solver, "solve", lambda *_: calls.append(1) or [solution])

    def got() -> MultipleScattering:
        solver._memory.clear()
        return _solved(_node())

    got()
    (path,) = store.rglob("*.npz")
    whole = path.read_bytes()
    assert got().bounce.moments[0, 0, 0] == 2.0
    assert len(calls) == 1
    positions = [*range(64), *range(64, len(whole) - 160, 97), *range(len(whole) - 160, len(whole))]
    for count, position in enumerate(positions, start=2):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << (position % 8)
        path.write_bytes(damaged)
        assert got() is solution
        assert len(calls) == count
        assert path.read_bytes() == whole
    other = content_key(_node(), ALTITUDE_M, PLANET_M + 1.0, COARSE)
    path.rename(path.with_name(f"{other}.npz"))
    _solved(_node(), PLANET_M + 1.0)
    assert len(calls) == len(positions) + 2, "a table under another's name is none"


def test_a_store_that_cannot_be_written_costs_only_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(solver, "_memory", type(solver._memory)())
    assert _solved(_node()).spherical_albedo > 0


def test_columns_are_solved_together_and_alike(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is solved beside a column, in memory already or not: its solution has the same bits."""
    hazy = replace(_node(), particle_per_m=0.3 * _node().molecular_per_m, asymmetry=np.full_like(ALTITUDE_M, 0.7))
    nodes = [_node(0.5), _node(), hazy, _node(2.0), _node(1.3), _node(0.7), _node(0.5)]
    calls: list[int] = []

    def counted(some: Sequence[SpectralNode], *rest: Any) -> list[MultipleScattering]:
        calls.append(len(some))
        return solve(some, *rest)

    monkeypatch.setattr(solver, "solve", counted)
    together = multiple_scattering(nodes, ALTITUDE_M, PLANET_M, COARSE, _sun_table)
    assert sorted(calls) == [1, 1, 4], "molecules by fours, particles apart, and what occurs twice once"
    for path in store.rglob("*.npz"):
        path.unlink()
    for node, beside in zip(nodes, together, strict=True):
        solver._memory.clear()
        alone = _solved(node)
        for name in ("air", "bounce"):
            a, b = getattr(alone, name), getattr(beside, name)
            np.testing.assert_array_equal(a.moments, b.moments)
            np.testing.assert_array_equal(a.irradiance, b.irradiance)
        assert alone.spherical_albedo == beside.spherical_albedo


def test_harmonics_without_light_are_not_stored() -> None:
    """The light from the ground has few harmonics of the many of a field: the others are as good as none."""
    rng = np.random.default_rng(5)
    few = rng.uniform(0.1, 1.0, (3, 4, len(pairs(4))))
    many = np.concatenate([few, np.zeros((3, 4, len(pairs(9)) - len(pairs(4))))], axis=2)
    irradiance = rng.uniform(0.1, 1.0, 4)
    tables = [
        SourceTable.of([DiffuseField(1e5, PLANET_M, degree, moments, irradiance)], 1, True)
        for moments, degree in ((few, 4), (many, 9))
    ]
    assert tables[1].used == pairs(4)
    np.testing.assert_array_equal(np.array(tables[0].moments), np.array(tables[1].moments))
