"""What the Earth hides of the Sun, against a computation of the test's own."""

import math

import numpy as np
import pytest

from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, sphere
from horizonval.geometry.sun_and_moon import sun_visible_fraction

SUN_RAD = 0.00465
SLICES = 128


def limb(r, e1, e2, azimuth, ellipsoid):
    """Directions of the limb, shape (n, k, 3), at azimuths (n, k) about the line to the Earth's centre.

    In the plane of an azimuth a line ``n + t e`` touches where the quadratic in ``t`` has a double root.
    """
    a = 1.0 / np.array([ellipsoid.a_m**2, ellipsoid.a_m**2, ellipsoid.b_m**2])
    n = -r / np.linalg.norm(r, axis=-1, keepdims=True)
    e = np.cos(azimuth)[..., None] * e1[:, None] + np.sin(azimuth)[..., None] * e2[:, None]
    outside = ((r * a * r).sum(-1) - 1.0)[:, None]
    rn, nn = (r * a * n).sum(-1)[:, None], (n * a * n).sum(-1)[:, None]
    re, ne, ee = np.einsum("ni,nki->nk", r * a, e), np.einsum("ni,nki->nk", n * a, e), (e * a * e).sum(-1)
    second, first, zeroth = re**2 - outside * ee, re * rn - outside * ne, rn**2 - outside * nn
    # The greater root of a parabola that opens downwards: the limb on this azimuth's side.
    t = (-first - np.sqrt(first**2 - second * zeroth)) / second
    d = n[:, None] + t[..., None] * e
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def angle(a, b):
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def hits(r, s, ellipsoid):
    """Whether the ray towards ``s`` meets the ellipsoid, by its nearest approach in flattened space."""
    p, d = r / ellipsoid.axes_m, s / ellipsoid.axes_m
    t = -(p @ d) / (d @ d)
    return (t > 0.0) & (np.linalg.norm(p + np.maximum(t, 0.0)[:, None] * d, axis=-1) < 1.0)


def reference(r, s, radius, ellipsoid):
    """Share of a small disc seen past a large Earth: ``(fraction, angle from the disc's centre to the limb)``.

    The nearest point of the limb is searched by golden section, the limb's ends in the disc by bisection, and the area
    between is a polygon's in Lambert's equal-area projection about the disc's centre, extrapolated to fine steps.
    """
    n = -r / np.linalg.norm(r, axis=-1, keepdims=True)
    e1 = s - (n @ s)[:, None] * n
    e1 /= np.linalg.norm(e1, axis=-1, keepdims=True)
    e2 = np.cross(n, e1)
    golden = (math.sqrt(5.0) - 1.0) / 2.0

    def distance(azimuth):
        return angle(limb(r, e1, e2, azimuth[:, None], ellipsoid)[:, 0], s)

    trial = np.linspace(-math.pi, math.pi, 73)
    best = trial[np.argmin([distance(np.full(len(r), x)) for x in trial], axis=0)]
    low, high = best - 0.1, best + 0.1
    for _ in range(60):
        left, right = high - golden * (high - low), low + golden * (high - low)
        nearer = distance(left) < distance(right)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    nearest = 0.5 * (low + high)
    gap = distance(nearest)
    dark = hits(r, s, ellipsoid)
    fraction = np.where(dark, 0.0, 1.0)
    partly = gap < radius
    ends = []
    for side in (-1.0, 1.0):
        inner, outer = nearest, nearest + side * 1.0
        for _ in range(60):
            middle = 0.5 * (inner + outer)
            within = distance(middle) < radius
            inner, outer = np.where(within, middle, inner), np.where(within, outer, middle)
        ends.append(inner)
    areas = []
    x = np.cross(s, [0.3, 0.5, 0.8])
    x /= np.linalg.norm(x)
    y = np.cross(s, x)
    for slices in (SLICES, 2 * SLICES):
        part = np.linspace(0.0, 1.0, slices + 1)
        d = limb(r, e1, e2, ends[0][:, None] + (ends[1] - ends[0])[:, None] * part, ellipsoid)
        stretch = np.sqrt(2.0 / (1.0 + d @ s))
        u, v = stretch * (d @ x), stretch * (d @ y)
        chain = 0.5 * (u[:, :-1] * v[:, 1:] - u[:, 1:] * v[:, :-1]).sum(-1)
        # Back along the disc's edge through what is hidden: counterclockwise, as azimuth about the nadir is.
        turn = np.mod(np.arctan2(v[:, 0], u[:, 0]) - np.arctan2(v[:, -1], u[:, -1]), 2.0 * math.pi)
        areas.append(chain + 2.0 * math.sin(radius / 2.0) ** 2 * turn)
    hidden = (4.0 * areas[1] - areas[0]) / 3.0 / (4.0 * math.pi * math.sin(radius / 2.0) ** 2)
    return np.where(partly, 1.0 - hidden, fraction), gap


def observers(rng, s, count, ellipsoid):
    """Observers from 200 to 36 000 km: round the shadow's edge, in the umbra, anywhere."""
    distance = ellipsoid.a_m + 10.0 ** rng.uniform(math.log10(200e3), math.log10(36e6), count)
    edge = np.arcsin(ellipsoid.a_m / distance)
    kind = rng.integers(3, size=count)
    off = np.select(
        [kind == 0, kind == 1],
        [edge + rng.uniform(-2.0, 1.5, count) * SUN_RAD, edge * np.sqrt(rng.uniform(size=count))],
        np.arccos(rng.uniform(-1.0, 1.0, count)),
    )
    x = np.cross(s, [0.1, 0.9, 0.2])
    x /= np.linalg.norm(x)
    turn = rng.uniform(0.0, 2.0 * math.pi, count)
    across = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(s, x)
    return distance[:, None] * (np.sin(off)[:, None] * across - np.cos(off)[:, None] * s)


def compare(count, seed):
    """Return how many are called umbra or full light wrongly, and the greatest difference."""
    rng = np.random.default_rng(seed)
    wrong, worst, kinds = 0, 0.0, np.zeros(3, int)
    for _ in range(10):
        s = rng.normal(size=3)
        s /= np.linalg.norm(s)
        for r in np.array_split(observers(rng, s, count // 10, WGS84), max(1, count // 10_000)):
            fraction = sun_visible_fraction(r, s, SUN_RAD)
            known, _ = reference(r, s, SUN_RAD, WGS84)
            wrong += int(((fraction == 0.0) != (known == 0.0)).sum() + ((fraction == 1.0) != (known == 1.0)).sum())
            worst = max(worst, float(np.abs(fraction - known).max()))
            kinds += [(known == 0.0).sum(), ((known > 0.0) & (known < 1.0)).sum(), (known == 1.0).sum()]
    assert kinds.min() > 0.1 * count
    return wrong, worst


@pytest.mark.parametrize("count", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_umbra_is_zero_and_full_light_is_one(count):
    wrong, worst = compare(count, seed=1)
    assert wrong == 0
    assert worst < 1e-9


def test_nothing_is_seen_through_the_earth():
    """Right behind the Earth, where the polynomial on the disc's edge hardly varies, or not at all."""
    rng = np.random.default_rng(3)
    s = np.array([0.0, 0.0, 1.0])
    assert float(sun_visible_fraction([0.0, 0.0, -6.9e6], s, SUN_RAD, sphere(6.371e6))) == 0.0
    assert float(sun_visible_fraction([0.0, 0.0, -6.9e6], s, SUN_RAD)) == 0.0
    r = 6.928e6 * (np.array([0.0, 0.0, -1.0]) + 0.3 * rng.normal(size=(500, 3)) * [1.0, 1.0, 0.0])
    r *= 6.928e6 / np.linalg.norm(r, axis=-1, keepdims=True)
    behind = -r @ s > 6.928e6 * math.cos(math.radians(65.0))
    assert behind.sum() > 300
    assert (sun_visible_fraction(r[behind], s, SUN_RAD) == 0.0).all()


@pytest.mark.parametrize("darkening", [(1.0,), (0.3, 0.93, -0.23)])
def test_ring_of_light(darkening):
    """A small body before the disc: the closed form while it is wholly inside, wherever it stands."""
    s, ball, own = np.array([0.6, 0.0, 0.8]), sphere(1.7374e6), 0.0040
    x = np.array([0.8, 0.0, -0.6])

    def light(radius):
        mu = math.sqrt(1.0 - (math.sin(radius) / math.sin(SUN_RAD)) ** 2)
        return sum(a / (k + 2) * (1.0 - mu ** (k + 2)) for k, a in enumerate(darkening))

    distance = ball.a_m / math.sin(own)
    centred = sun_visible_fraction(-distance * s, s, SUN_RAD, ball, darkening)
    share = (1.0 - math.cos(own)) / (1.0 - math.cos(SUN_RAD)) if len(darkening) == 1 else light(own) / light(SUN_RAD)
    assert float(centred) == pytest.approx(1.0 - share, abs=1e-10)
    if len(darkening) == 1:
        moved = sun_visible_fraction(-distance * math.cos(5e-4) * (s + math.tan(5e-4) * x), s, SUN_RAD, ball)
        assert float(moved) == pytest.approx(1.0 - share, abs=1e-9)
    assert float(sun_visible_fraction(-distance * (s + 0.01 * x), s, SUN_RAD, ball, darkening)) == 1.0
    assert 0.0 < float(sun_visible_fraction(-distance * (s + 0.004 * x), s, SUN_RAD, ball, darkening)) < 1.0


def test_flat_body_that_crosses_the_edge_four_times():
    """A lens-shaped body, wider and flatter than the disc: the sum of many strips."""
    body, radius = Ellipsoid(1.0, 0.4), 0.1
    s, r = np.array([1.0, 0.0, 0.0]), np.array([-6.9, 0.0, 0.0])
    angle_up = (np.arange(900) + 0.5) / 900 * 2.0 * math.pi
    off = (np.arange(900) + 0.5) / 900 * radius
    up, out = np.meshgrid(angle_up, off)
    d = np.stack([np.cos(out), np.sin(out) * np.cos(up), np.sin(out) * np.sin(up)], axis=-1) / body.axes_m
    p = r / body.axes_m
    hidden = (d @ p) ** 2 > (p @ p - 1.0) * (d**2).sum(-1)
    weight = np.sin(out)
    seen = 1.0 - (hidden * weight).sum() / weight.sum()
    assert float(sun_visible_fraction(r, s, radius, body)) == pytest.approx(seen, abs=1e-3)


def test_observer_on_the_ground_sees_half_at_sunset():
    """The level plane through the Sun's centre halves the disc, also for one who stands a rounding below the ground."""
    for off in (0.0, 0.5, -0.5):
        zenith = math.pi / 2.0 + off * SUN_RAD
        s = np.array([math.cos(zenith), math.sin(zenith), 0.0])
        segment = (math.acos(off) - off * math.sqrt(1.0 - off**2)) / math.pi
        for radius_m in (WGS84.a_m, math.nextafter(WGS84.a_m, 0.0)):
            seen = float(sun_visible_fraction([radius_m, 0.0, 0.0], s, SUN_RAD))
            assert seen == pytest.approx(segment, abs=1e-5)
    assert float(sun_visible_fraction([WGS84.a_m, 0.0, 0.0], [-1.0, 0.0, 0.0], SUN_RAD)) == 0.0
    assert float(sun_visible_fraction([WGS84.a_m, 0.0, 0.0], [1.0, 0.0, 0.0], SUN_RAD)) == 1.0


def test_limb_darkening_is_that_of_the_disc_in_strips():
    s, darkening = np.array([1.0, 0.0, 0.0]), np.array([0.3, 0.93, -0.23])
    edge = math.asin(WGS84.a_m / 7e6)
    turn = edge - 0.4 * SUN_RAD
    r = 7e6 * np.array([-math.cos(turn), math.sin(turn), 0.0])
    up, out = np.meshgrid((np.arange(900) + 0.5) / 900 * 2.0 * math.pi, (np.arange(900) + 0.5) / 900 * SUN_RAD)
    d = np.stack([np.cos(out), np.sin(out) * np.cos(up), np.sin(out) * np.sin(up)], axis=-1)
    mu = np.sqrt(1.0 - (np.sin(out) / math.sin(SUN_RAD)) ** 2)
    weight = np.sin(out) * np.cos(out) * (darkening[0] + darkening[1] * mu + darkening[2] * mu**2)
    hidden = hits(np.broadcast_to(r, (1, 3)), s, WGS84)
    assert hidden[0]
    p, flat = r / WGS84.axes_m, d / WGS84.axes_m
    dark = (flat @ p) ** 2 > (p @ p - 1.0) * (flat**2).sum(-1)
    seen = 1.0 - (dark * weight).sum() / weight.sum()
    assert float(sun_visible_fraction(r, s, SUN_RAD, WGS84, darkening)) == pytest.approx(seen, abs=1e-3)
