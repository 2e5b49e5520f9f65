"""The consensus as arrays against its definition, one point and one triple at a time."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from horizonval.estimation.limb import consensus
from horizonval.estimation.limb.consensus import COS_GRADIENT, EdgePoints, off_limb_px, support, to_sight, to_sights
from horizonval.estimation.limb.edges import Edges
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.result import LimbPoints
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.cone import cones_through
from horizonval.geometry.directions import off_axis_angle

CAMERA = CameraModel(160, 120, 150.0, 150.0, 79.5, 59.5, (-0.1, 0.02, 0.0, 0.0, 0.0))
AXIS = np.array([0.1, 0.85, 0.5]) / np.linalg.norm([0.1, 0.85, 0.5])
RHO_RAD = float(np.radians(52.0))
COSINE = float(np.cos(RHO_RAD))


def scattered(count: int = 400, seed: int = 1) -> EdgePoints:
    """Points all over the image; half of them look along the limb's normal, to either side."""
    rng = np.random.default_rng(seed)
    uv = np.column_stack([rng.integers(8, 152, count), rng.integers(8, 112, count)]).astype(float)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    gradient = np.column_stack([np.cos(angle), np.sin(angle)])
    sight = to_sight(Edges(uv, gradient, rng.uniform(0.1, 1.0, count)), CAMERA, (120, 160))
    normal = np.einsum("nij,i->nj", sight.jacobian, AXIS)
    normal *= (rng.choice([-1.0, 1.0], count) / np.linalg.norm(normal, axis=1))[:, None]
    half = np.where(np.arange(count)[:, None] % 2 == 0, normal, sight.gradient)
    return EdgePoints(sight.uv, half, sight.los_cam, sight.jacobian, sight.quiet, sight.shape)


def turn_of(sight: EdgePoints, point: int, axis: np.ndarray) -> float:
    normal = sight.jacobian[point].T @ axis
    return float(sight.gradient[point] @ normal / np.linalg.norm(normal))


def off_of(sight: EdgePoints, point: int) -> float:
    return float((sight.los_cam[point] @ AXIS - COSINE) / np.linalg.norm(sight.jacobian[point].T @ AXIS))


@pytest.mark.parametrize("few", [0, 10_000])
@pytest.mark.parametrize("bright_inside", [True, False])
@pytest.mark.parametrize("slack", [1.0, 2.0])
def test_support_is_its_definition(
    monkeypatch: pytest.MonkeyPatch, few: int, bright_inside: bool, slack: float
) -> None:
    monkeypatch.setattr(consensus, "FEW", few)
    sight = scattered(2000)
    px_rad = np.linalg.norm(sight.jacobian, axis=(1, 2)) / np.sqrt(2.0)
    relief = consensus.LIMB_RELIEF * np.sqrt(1.0 - COSINE**2) / COSINE / px_rad
    tolerance = np.minimum(1.5 + relief, max(1.5, consensus.LARGEST_TOLERANCE_SHARE * 120))
    sign = 1.0 if bright_inside else -1.0
    expected = [
        abs(off_of(sight, k)) <= slack * tolerance[k] and sign * turn_of(sight, k, AXIS) >= COS_GRADIENT
        for k in range(len(sight.uv))
    ]
    supports = support(sight, AXIS, COSINE, bright_inside, slack)
    assert 5 < np.count_nonzero(supports) < 200
    assert supports.tolist() == expected
    assert off_limb_px(sight, AXIS, COSINE) == pytest.approx(
        [off_of(sight, k) for k in range(2000)], rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize(("at_once", "tried"), [(7, 60), (5000, 60), (300, 4), (300, 100_000)])
def test_the_first_triples_that_agree_are_tried(monkeypatch: pytest.MonkeyPatch, at_once: int, tried: int) -> None:
    monkeypatch.setattr(consensus, "TRIPLES_AT_ONCE", at_once)
    monkeypatch.setattr(consensus, "TRIED", tried)
    sight = scattered(60)
    triples = np.random.default_rng(2).integers(0, 60, (3000, 3))
    axes, _ = cones_through(*(sight.los_cam[triples[:, i]] for i in range(3)))
    expected: tuple[list, list] = ([], [])
    for triple, axis in zip(triples, axes, strict=True):
        a, b, c = sight.uv[triple]
        if min(np.linalg.norm(a - b), np.linalg.norm(b - c), np.linalg.norm(a - c)) <= 0.04 * 120:
            continue
        turns = np.array([turn_of(sight, point, axis) for point in triple])
        for polarity, sign in enumerate((1.0, -1.0)):
            if (sign * turns >= COS_GRADIENT).all() and len(expected[polarity]) < tried:
                expected[polarity].append(triple.tolist())
    inside, outside = consensus._agreeing(sight, triples)
    assert len(expected[0]) >= min(tried, 4)
    assert len(expected[1]) >= min(tried, 4)
    assert inside.tolist() == expected[0]
    assert outside.tolist() == expected[1]


def test_selections_share_their_lines_of_sight() -> None:
    sight = scattered(50)
    edges = Edges(sight.uv, sight.gradient, sight.quiet)
    some, others = to_sights(edges, CAMERA, (120, 160), np.array([7, 3, 20]), np.array([3, 49]))
    assert np.array_equal(some.uv, sight.uv[[3, 7, 20]])
    # To undistort points takes steps that hang together, in the last bits.
    assert others.los_cam == pytest.approx(sight.los_cam[[3, 49]], abs=1e-13)
    assert np.array_equal(others.quiet, sight.quiet[[3, 49]])


def test_the_points_are_the_same_for_any_number_of_threads() -> None:
    depth = RHO_RAD - off_axis_angle(unproject(CAMERA, pixel_grid(CAMERA)), AXIS)
    noise = np.random.default_rng(3).normal(0.0, 10.0, depth.shape)
    image = np.clip(np.where(depth > 0.0, 700.0, 30.0) + noise, 0.0, 1023.0)
    threads = cv2.getNumThreads()
    points = []
    for count in (1, 4):
        cv2.setNumThreads(count)
        points.append(find_limb(image, CAMERA, 1023.0))
    cv2.setNumThreads(threads)
    assert all(isinstance(one, LimbPoints) for one in points)
    assert np.array_equal(points[0].uv, points[1].uv)
    assert np.array_equal(points[0].los_cam, points[1].los_cam)
