"""The vertical from two arcs, on horizons drawn with the exact tangent cone of a sphere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.arc import Arc, fit_circle
from horizonval.estimation.methods import video_vertical
from horizonval.estimation.methods.video_vertical import ESTIMATOR, ChordEnds, fit_arcs, solve, vertical
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry import frames
from horizonval.geometry.camera import CameraModel, pixel_grid, project, unproject
from horizonval.geometry.rotation import angle_between, tangent_basis

WIDTH = 512
CAMERA = CameraModel(WIDTH, WIDTH, 215.0, 215.0, (WIDTH - 1) / 2, (WIDTH - 1) / 2)
"""A field of 100 deg."""
MOUNTS = {
    "left": frames.cam_from_body(0.0, 0.0, math.pi / 2),
    "forward": frames.cam_from_body(math.pi / 2, 0.0, math.pi / 2),
}
RADIUS_M = 6371008.8
RHO = math.asin(RADIUS_M / (RADIUS_M + 500e3))


def sphere_image(nadir_cam: np.ndarray, rho: float = RHO, bright: float = 800.0, dark: float = 30.0) -> np.ndarray:
    """A bright ball before space; the edge's pixels hold the share of themselves that the ball covers (linear ramp)."""
    los = unproject(CAMERA, pixel_grid(CAMERA))
    inside_px = (los @ nadir_cam - math.cos(rho)) / math.sin(rho) * CAMERA.fx
    # the local scale is fx / cos^2 along a radius; a ramp of that order is all an edge detector needs
    return dark + (bright - dark) * np.clip(0.5 + inside_px, 0.0, 1.0)


def two_heads(pitch_deg: float, roll_deg: float, seed: int | None = None, **changes: np.ndarray) -> Observation:
    nadir_body = frames.nadir_of_roll_pitch(math.radians(roll_deg), math.radians(pitch_deg))
    noise = None if seed is None else np.random.default_rng(seed)
    heads = {}
    for name, mount in MOUNTS.items():
        image = changes.get(name)
        if image is None:
            image = sphere_image(frames.rotate(mount, nadir_body))
            if noise is not None:
                image = np.rint(image + noise.normal(0.0, 8.0, image.shape))
        heads[name] = Observation(
            image, CAMERA, q_cam_from_body=mount, full_scale=1023.0, prior=Prior(shape="sphere", radius_m=RADIUS_M)
        )
    return replace(heads["left"], heads=heads)


def error_rad(fit: Fit, pitch_deg: float, roll_deg: float) -> float:
    nadir_body = frames.nadir_of_roll_pitch(math.radians(roll_deg), math.radians(pitch_deg))
    return angle_between(frames.rotate(MOUNTS["left"], nadir_body), fit.nadir_cam)


def exact_arc(nadir_cam: np.ndarray, rho: float, low: float, high: float, n: int = 400) -> Arc:
    """Points of the cone's exact image between two azimuths about the nadir, measured from the boresight's."""
    across = np.array([0.0, 0.0, 1.0]) - nadir_cam[2] * nadir_cam
    across /= np.linalg.norm(across)
    angle = np.linspace(low, high, n)[:, None]
    ring = np.cos(angle) * across + np.sin(angle) * np.cross(nadir_cam, across)
    uv, in_front = project(CAMERA, math.cos(rho) * nadir_cam + math.sin(rho) * ring)
    assert in_front.all()
    circle = fit_circle(uv)
    assert circle is not None
    return Arc(uv[np.argsort(circle.along(uv), kind="stable")], circle)


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(0.0, 0.0), (20.0, -15.0), (-12.0, 17.0), (-30.0, 5.0)])
@pytest.mark.parametrize("ends", [ChordEnds.SIGHT, ChordEnds.PIXEL])
def test_chords_of_lines_of_sight_give_the_exact_vertical_from_any_piece_of_the_horizon(
    pitch_deg: float, roll_deg: float, ends: ChordEnds
) -> None:
    nadir_body = frames.nadir_of_roll_pitch(math.radians(roll_deg), math.radians(pitch_deg))
    observation = two_heads(pitch_deg, roll_deg)
    # lopsided pieces: the exactness must not need a symmetric arc
    pieces = {"left": (-0.9, 0.3), "forward": (-0.2, 0.8)}
    arcs = [exact_arc(frames.rotate(MOUNTS[name], nadir_body), RHO, *piece) for name, piece in pieces.items()]
    fit = fit_arcs(arcs, list(observation.heads.values()), ends)
    assert isinstance(fit, Fit)
    # rounding of some hundred operations of size one
    assert error_rad(fit, pitch_deg, roll_deg) < 1e-12
    assert fit.pitch_rad == pytest.approx(math.radians(pitch_deg), abs=1e-12)
    assert fit.roll_rad == pytest.approx(math.radians(roll_deg), abs=1e-12)
    assert fit.angular_radius_rad == pytest.approx(RHO, abs=1e-12)
    # d altitude / d rho is 2.9e6 m: 1e-12 rad are 3 um
    assert fit.altitude_m == pytest.approx(500e3, abs=1e-3)


def test_the_other_readings_are_exact_only_for_a_level_pair() -> None:
    level, tilted = two_heads(0.0, 0.0), two_heads(12.0, 14.0)
    errors = {}
    for ends in ChordEnds:
        fit, other = solve(level, ends), solve(tilted, ends)
        assert isinstance(fit, Fit)
        assert isinstance(other, Fit)
        # a level horizon is symmetric in both images, whatever joins its ends
        assert math.degrees(error_rad(fit, 0.0, 0.0)) < 0.01
        errors[ends] = math.degrees(error_rad(other, 12.0, 14.0))
    # one pixel of 512 is 0.27 deg at the middle; rounding to 0.29 px on chords of 500 px is 0.06 deg
    assert errors[ChordEnds.SIGHT] < 0.1
    assert errors[ChordEnds.CIRCLE] > 0.1
    assert errors[ChordEnds.PLANE] > 1.0


@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_the_earth_lies_on_the_side_of_the_centre_whether_bright_or_dark(scale: float) -> None:
    observation = two_heads(5.0, -8.0)
    heads = {
        name: replace(head, image=512.0 + scale * (head.image - 512.0)) for name, head in observation.heads.items()
    }
    fit = ESTIMATOR.run(replace(heads["left"], heads=heads))
    assert isinstance(fit, Fit)
    # four rounded pixels; the wrong side would be 180 deg off
    assert math.degrees(error_rad(fit, 5.0, -8.0)) < 0.15


def test_the_claimed_covariance_is_honest_on_noisy_images() -> None:
    rng = np.random.default_rng(20)
    nees = []
    for seed in range(40):
        pitch, roll = rng.uniform(-18.0, 18.0, 2)
        fit = ESTIMATOR.run(two_heads(pitch, roll, seed))
        assert isinstance(fit, Fit)
        body = frames.nadir_of_roll_pitch(math.radians(roll), math.radians(pitch))
        error = fit.nadir_cam - frames.rotate(MOUNTS["left"], body)
        nees.append(float(error @ np.linalg.pinv(fit.covariance_nadir_cam, rcond=1e-6) @ error))
    # mean of 40 chi-square of 2 degrees of freedom: 2 +- 0.32; the rounding of neighbours is neither equal nor
    # independent, for which the variance claimed may be up to a half off
    assert 1.0 < np.mean(nees) < 3.0


@pytest.mark.parametrize("names", [(), ("left",), ("left", "forward", "left2")])
def test_other_numbers_of_heads_are_refused(names: tuple[str, ...]) -> None:
    observation = two_heads(0.0, 0.0)
    heads = {name: observation.heads["left"] for name in names}
    found = ESTIMATOR.run(replace(observation, heads=heads))
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT


def test_a_dark_head_is_named() -> None:
    dark = np.rint(np.random.default_rng(1).normal(32.0, 1.5, (WIDTH, WIDTH)))
    found = ESTIMATOR.run(two_heads(0.0, 0.0, forward=dark))
    assert isinstance(found, Refusal)
    assert found.status is Outcome.DARK
    assert "forward" in found.reason


def test_an_image_of_another_size_is_refused() -> None:
    found = ESTIMATOR.run(two_heads(0.0, 0.0, left=np.zeros((20, 30))))
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT


def test_two_heads_that_look_the_same_way_span_no_plane() -> None:
    observation = two_heads(0.0, 0.0)
    heads = {"left": observation.heads["left"], "again": observation.heads["left"]}
    found = ESTIMATOR.run(replace(observation, heads=heads))
    assert isinstance(found, Refusal)
    assert found.status is Outcome.SHORT_ARC
    assert vertical(np.zeros((2, 3))) is None


def noisy_arcs(rng: np.random.Generator, sigma_px: float, memory: float) -> tuple[list[Arc], list[Observation]]:
    """Exact arcs of a level pair, off across the limb by noise that forgets by ``memory`` from point to point."""
    arcs, heads = [], []
    for mount in MOUNTS.values():
        nadir = frames.rotate(mount, np.array([0.0, 0.0, 1.0]))
        arc = exact_arc(nadir, RHO, -0.5, 0.5)
        off = np.empty(len(arc.uv))
        off[0] = rng.normal()
        for k in range(1, len(off)):
            off[k] = memory * off[k - 1] + math.sqrt(1.0 - memory**2) * rng.normal()
        outwards = arc.uv - arc.circle.centre
        outwards /= np.hypot(*outwards.T)[:, None]
        circle = arc.circle
        arcs.append(Arc(arc.uv + sigma_px * off[:, None] * outwards, circle))
        heads.append(Observation(np.zeros((WIDTH, WIDTH)), CAMERA, q_cam_from_body=mount))
    return arcs, heads


def test_points_below_the_pixel_claim_their_own_scatter() -> None:
    """Mean normalised error squared of 2 degrees of freedom over 200 draws: 2 +- 0.14."""
    rng = np.random.default_rng(5)
    nees = []
    for _ in range(200):
        arcs, heads = noisy_arcs(rng, 0.6, 0.0)
        fit = video_vertical.fit_arcs(arcs, heads, sub_pixel=True)
        assert isinstance(fit, Fit)
        basis = tangent_basis(fit.nadir_cam)
        off = basis.T @ frames.rotate(MOUNTS["left"], np.array([0.0, 0.0, 1.0]))
        nees.append(off @ np.linalg.solve(basis.T @ fit.covariance_nadir_cam @ basis, off))
        assert fit.systematic_nadir_cam is not None
    assert 1.4 < np.mean(nees) < 2.8


def test_an_ends_pixels_are_at_most_one() -> None:
    """The mean of the last pixels of an arc has a share of one's variance: all of it where they are off alike."""
    rng = np.random.default_rng(6)
    claims = {}
    for memory in (0.0, 0.97):
        traces = []
        for _ in range(12):
            arcs, heads = noisy_arcs(rng, 1.0, memory)
            fit = video_vertical.fit_arcs(arcs, heads, sub_pixel=True)
            assert isinstance(fit, Fit)
            one_px = fit.systematic_nadir_cam
            assert one_px is not None
            traces.append(np.trace(fit.covariance_nadir_cam) / np.trace(one_px) * video_vertical.SLOW_PX**2)
        claims[memory] = float(np.mean(traces))
    assert claims[0.0] == pytest.approx(1.0 / video_vertical.END_PIXELS, rel=0.4)
    assert 0.4 < claims[0.97] < 1.2
