"""Parts of the search for the limb: checks, edges, arcs and circles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.arc import FEWEST_PIXELS, Arc, find_arc, fit_circle
from horizonval.estimation.limb.edges import canny
from horizonval.estimation.limb.finder import find_limb, shows_sun
from horizonval.estimation.limb.picture import SMALLEST_SIDE_PX, check_image, noise_sigma, saturated_pixels
from horizonval.geometry.camera import CameraModel


def half_plane(size: int, angle_deg: float, offset: float, dark: float = 10.0, bright: float = 110.0) -> np.ndarray:
    """Share of every pixel on one side of a straight edge through the middle, as levels; 32 x 32 points a pixel."""
    fine = (np.arange(size * 32) + 0.5) / 32 - 0.5
    x, y = np.meshgrid(fine, fine)
    middle = (size - 1) / 2
    normal = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    lit = (x - middle) * normal[0] + (y - middle) * normal[1] > offset
    return dark + (bright - dark) * lit.reshape(size, 32, size, 32).mean(axis=(1, 3))


def disc(size: int, column: float, row: float, radius: float) -> np.ndarray:
    """Whether a pixel's centre lies in a disc."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    return np.hypot(x - column, y - row) <= radius


def noise(shape: tuple[int, ...] = (40, 40)) -> np.ndarray:
    return np.random.default_rng(1).uniform(20.0, 200.0, shape)


@pytest.mark.parametrize(
    ("image", "full_scale", "outcome"),
    [
        (noise(), None, None),
        (noise(), 1023.0, None),
        ("no image", None, Outcome.BAD_INPUT),
        (noise().astype(complex), None, Outcome.BAD_INPUT),
        (noise((40,)), None, Outcome.BAD_INPUT),
        (noise((40, 40, 3)), None, Outcome.BAD_INPUT),
        (noise((SMALLEST_SIDE_PX - 1, 40)), None, Outcome.BAD_INPUT),
        (noise((40, SMALLEST_SIDE_PX - 1)), None, Outcome.BAD_INPUT),
        (noise((SMALLEST_SIDE_PX, SMALLEST_SIDE_PX)), None, None),
        (np.where(noise() > 199.0, np.nan, noise()), None, Outcome.BAD_INPUT),
        (np.where(noise() > 199.0, np.inf, noise()), None, Outcome.BAD_INPUT),
        (np.full((40, 40), 255.0), None, Outcome.SATURATED),
        (np.full((40, 40), 65535.0), None, Outcome.SATURATED),
        (np.full((40, 40), 255.0), 1023.0, Outcome.NO_LIMB),
        (np.full((40, 40), 1023.0), 1023.0, Outcome.SATURATED),
        (np.full((40, 40), 1100.0), 1023.0, Outcome.SATURATED),
        (np.zeros((40, 40)), None, Outcome.DARK),
        (np.full((40, 40), 5.0), 1023.0, Outcome.DARK),
        (np.full((40, 40), 60.0), 1023.0, Outcome.NO_LIMB),
        (np.full((40, 40), 60.0), None, Outcome.NO_LIMB),
        (np.where(np.arange(1600).reshape(40, 40) < 80, noise(), 1023.0), 1023.0, Outcome.SATURATED),
        (np.where(np.arange(1600).reshape(40, 40) < 400, noise(), 1023.0), 1023.0, None),
    ],
)
def test_what_cannot_hold_a_limb_is_refused_with_its_reason(
    image: object, full_scale: float | None, outcome: Outcome | None
) -> None:
    refusal = check_image(image, full_scale)  # type: ignore[arg-type]
    assert (None if refusal is None else refusal.status) == outcome


def test_saturation_is_full_scale_or_a_plateau() -> None:
    image = noise()
    assert not saturated_pixels(image).any(), "a single brightest pixel is none"
    image[3, :8] = 250.0
    assert not saturated_pixels(image).any()
    image[3, 8] = 250.0
    assert (saturated_pixels(image) == (image == 250.0)).all()
    assert (saturated_pixels(image, 100.0) == (image >= 100.0)).all()
    assert not saturated_pixels(image, 251.0).any()


@pytest.mark.parametrize(("column", "row", "radius"), [(50.0, 40.0, 6.0), (20.0, 90.0, 10.5), (0.0, 60.0, 8.0)])
def test_the_sun_is_seen(column: float, row: float, radius: float) -> None:
    assert shows_sun(disc(120, column, row, radius))


def test_what_is_not_the_sun() -> None:
    assert not shows_sun(np.zeros((120, 120), dtype=bool))
    assert not shows_sun(disc(120, 60, 60, 1.2)), "a few hot pixels"
    assert not shows_sun(disc(120, 60, 60, 25)), "too wide"
    bar = np.zeros((120, 120), dtype=bool)
    bar[50:54, 40:70] = True
    assert not shows_sun(bar), "no disc"
    assert not shows_sun(bar.T)
    ring = disc(120, 60, 60, 14) & ~disc(120, 60, 60, 11)
    assert not shows_sun(ring), "hollow"
    clouds = sum((disc(120, c, r, 5) for c, r in ((20, 20), (60, 20), (20, 80), (90, 90))), np.zeros((120, 120), bool))
    assert not shows_sun(clouds), "one of many"
    assert shows_sun(disc(120, 30, 30, 4) | disc(120, 80, 90, 12)), "the largest"


@pytest.mark.parametrize("sigma", [0.5, 7.0])
def test_noise_is_measured_in_front_of_edges_and_slopes(sigma: float) -> None:
    x, y = np.meshgrid(np.arange(300.0), np.arange(200.0))
    scene = 3.0 * x - 2.0 * y + np.where(x > 150.0 + 0.2 * y, 500.0, 0.0)
    image = scene + np.random.default_rng(2).normal(0.0, sigma, scene.shape)
    assert noise_sigma(image) == pytest.approx(sigma, rel=0.04)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0, 180.0, 270.0, 30.0])
def test_edges_lie_on_the_edge(angle_deg: float) -> None:
    image = half_plane(60, angle_deg, 3.0, 20.0, 220.0)
    uv = np.argwhere(canny(image.astype(np.float32), 1.0)[0])[:, ::-1]
    normal = np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])
    assert len(uv) > 40
    assert np.abs((uv - 29.5) @ normal - 3.0).max() <= 1.0
    assert uv.min() >= 2
    assert uv.max() < 58
    assert (np.abs(uv - 29.5) > 23).any(), "up to the rim that is left out"


def test_the_arc_of_a_disc_is_its_circle_in_order() -> None:
    image = np.where(disc(160, 70.0, 190.0, 120.0), 200.0, 20.0)
    arc = find_arc(image)
    assert isinstance(arc, Arc)
    assert arc.circle.centre == pytest.approx([70.0, 190.0], abs=1.0)
    assert arc.circle.radius_px == pytest.approx(120.0, abs=1.0)
    assert np.hypot(*np.diff(arc.uv, axis=0).T).max() < 3.0, "neighbours follow each other"
    tall = find_arc(np.vstack([np.full((90, 160), 20.0), image]))
    assert isinstance(tall, Arc)
    assert tall.circle.centre == pytest.approx(arc.circle.centre + np.array([0.0, 90.0]), abs=0.2)
    spotted = image.copy()
    spotted[20:26, 20:26] = 200.0
    again = find_arc(spotted)
    assert isinstance(again, Arc)
    assert again.circle.centre == pytest.approx(arc.circle.centre, abs=0.2)


def test_what_is_no_arc() -> None:
    straight = find_arc(half_plane(80, 0.0, 0.0))
    assert isinstance(straight, Refusal)
    assert straight.status in (Outcome.SHORT_ARC, Outcome.NO_LIMB)
    few = np.where(disc(80, 40, 40, 2.0), 900.0, 20.0)
    reasons = []
    for image in (few, few / 10):
        refusal = find_arc(image, 1023.0)
        assert isinstance(refusal, Refusal)
        reasons.append(refusal.status)
    assert 4 * math.pi < FEWEST_PIXELS
    assert reasons == [Outcome.NO_LIMB, Outcome.DARK]
    blank = find_arc(np.zeros((40, 40)))
    assert isinstance(blank, Refusal)
    assert blank.status is Outcome.DARK


@pytest.mark.parametrize("level", [40.0, 400.0])
def test_a_bright_line_is_no_limb(level: float) -> None:
    """Both of its sides are the same: there is no inside."""
    x, y = np.meshgrid(np.arange(120.0), np.arange(120.0))
    away = np.hypot(x - 60.0, y - 190.0) - 130.0
    image = level + 500.0 * np.exp(-0.5 * (away / 1.2) ** 2)
    assert isinstance(find_limb(image, CameraModel(120, 120, 140.0, 140.0, 59.5, 59.5)), Refusal)


@pytest.mark.parametrize("arc_deg", [5.0, 40.0, 360.0])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_points_of_a_circle_give_it_back(arc_deg: float, offset: float) -> None:
    angle = np.radians(np.linspace(20.0, 20.0 + arc_deg, 200))
    uv = offset + np.array([300.0, -800.0]) + 1500.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    circle = fit_circle(uv)
    assert circle is not None
    # the coordinates' own rounding, amplified by (radius / sagitta): 1e-11 px times 1e3 and 10 for the offset's digits
    assert circle.centre == pytest.approx(offset + np.array([300.0, -800.0]), abs=1e-5)
    assert circle.radius_px == pytest.approx(1500.0, abs=1e-5)
    assert np.abs(circle.distance_px(uv)).max() < 1e-6
    assert circle.nearest(uv) == pytest.approx(uv, abs=1e-6)


def test_the_fit_of_a_noisy_short_arc_is_not_biased_towards_small_circles() -> None:
    """Kasa's fit shrinks short arcs; Taubin's must not, to first order (Chernov 2010, section 5.9)."""
    rng = np.random.default_rng(3)
    angle = np.radians(np.linspace(-15.0, 15.0, 300))
    exact = 1000.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    radii, shrunk = [], []
    for _ in range(200):
        uv = exact + rng.normal(0.0, 2.0, exact.shape)
        circle = fit_circle(uv)
        assert circle is not None
        radii.append(circle.radius_px)
        kasa = np.linalg.lstsq(np.column_stack([uv, np.ones(300)]), (uv**2).sum(axis=1), rcond=None)[0]
        shrunk.append(np.sqrt(kasa[2] + (kasa[:2] ** 2).sum() / 4))
    error = np.std(radii) / np.sqrt(200)
    assert np.mean(radii) == pytest.approx(1000.0, abs=4 * error)
    assert np.mean(shrunk) < 1000.0 - 4 * error
