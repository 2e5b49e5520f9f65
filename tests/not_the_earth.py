"""Pictures that are not the Earth, of which no limb method may claim an attitude.

Each is drawn by a formula in the image plane or over the angle from a direction, on a grid three times finer, summed
to pixels, with noise of its own seed, as whole numbers of eight bits. Nothing of the package draws.

A disc of even brightness *is* what the Earth looks like from some altitude: a picture that could be the Earth comes
with what a flight computer knows, an altitude of 500 km, a position and a coarse attitude, and contradicts it. Half of
the pictures have that knowledge, half have none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

WIDTH, HEIGHT, FOCAL_PX = 192, 144, 110.0
FULL_SCALE = 255.0
FINE = 3
SEED = 20
ALTITUDE_M = 500e3
NADIR_OFF_DEG = 62.0
"""Of the known attitude, from the camera's axis towards the image's bottom."""

Grid = tuple[np.ndarray, np.ndarray]
Draw = Callable[[Grid, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Picture:
    """``image`` (HEIGHT, WIDTH) of whole numbers up to FULL_SCALE; ``known``: whether altitude and pose are given."""

    name: str
    image: np.ndarray
    known: bool


def _angle(at: Grid, u: float, v: float, unit_px: float = FOCAL_PX) -> np.ndarray:
    """Angle [deg] from the direction that is seen at (u, v)."""
    a = [(at[0] - (WIDTH - 1) / 2) / unit_px, (at[1] - (HEIGHT - 1) / 2) / unit_px]
    b = [(u - (WIDTH - 1) / 2) / unit_px, (v - (HEIGHT - 1) / 2) / unit_px]
    cosine = (a[0] * b[0] + a[1] * b[1] + 1.0) / np.sqrt((a[0] ** 2 + a[1] ** 2 + 1.0) * (b[0] ** 2 + b[1] ** 2 + 1.0))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _disc(u: float, v: float, radius_deg: float, bright: float = 180.0) -> Draw:
    return lambda at, rng: bright * (_angle(at, u, v) < radius_deg)


def _two_discs(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 110.0 * (_angle(at, 90.0, 70.0) < 28.0) + 90.0 * (_angle(at, 102.0, 76.0) < 15.0)


def _crescent(radius_deg: float, u: float, v: float, phase: float) -> Draw:
    """A disc lit from the side: its terminator is half an ellipse, its light falls to nothing there."""

    def draw(at: Grid, rng: np.random.Generator) -> np.ndarray:
        x, y = (at[0] - u) / FOCAL_PX, (at[1] - v) / FOCAL_PX
        size = np.tan(np.radians(radius_deg))
        z = np.sqrt(np.clip(size**2 - x**2 - y**2, 0.0, None))
        light = (np.cos(phase) * z + np.sin(phase) * (0.8 * x + 0.6 * y)) / size
        return 230.0 * np.sqrt(np.clip(light, 0.0, None)) * (x**2 + y**2 < size**2)

    return draw


def _vignette(radius_px: float, width_px: float, noise: float, level: float = 90.0, off: float = 0.0) -> Draw:
    """A lens that darkens towards its rim, and noise as strong as the light behind it."""

    def draw(at: Grid, rng: np.random.Generator) -> np.ndarray:
        r = np.hypot(at[0] - (WIDTH - 1) / 2 - off, at[1] - (HEIGHT - 1) / 2)
        lens = 1.0 / (1.0 + np.exp(np.clip((r - radius_px) / width_px, -50.0, 50.0)))
        return lens * _per_pixel(level + noise * rng.normal(size=(HEIGHT, WIDTH)))

    return draw


def _per_pixel(values: np.ndarray) -> np.ndarray:
    return np.repeat(np.repeat(values, FINE, axis=0), FINE, axis=1)


def _noise(level: float, sigma: float) -> Draw:
    return lambda at, rng: _per_pixel(level + sigma * rng.normal(size=(HEIGHT, WIDTH)))


def _waves(rng: np.random.Generator, at: Grid, longest_px: float, exponent: float, count: int = 80) -> np.ndarray:
    """A texture of plane waves of random directions with a power law of amplitudes, of unit variance."""
    total = np.zeros_like(at[0])
    for length in longest_px * rng.uniform(0.02, 1.0, count):
        direction, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        k = 2.0 * np.pi / max(length, 3.0)
        wave = np.cos(k * (np.cos(direction) * at[0] + np.sin(direction) * at[1]) + phase)
        total += length**exponent * wave
    return total / total.std()


def _clouds(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 90.0 + 110.0 / (1.0 + np.exp(-3.0 * _waves(rng, at, 80.0, 0.8)))


def _lamp(at: Grid, rng: np.random.Generator) -> np.ndarray:
    r = np.hypot(at[0] - 95.0, at[1] - 66.0)
    rings = 60.0 * np.exp(-(((r - 38.0) / 2.5) ** 2)) + 35.0 * np.exp(-(((r - 58.0) / 2.5) ** 2))
    return 4000.0 / (1.0 + (r / 3.0) ** 2) + rings


def _ghosts(at: Grid, rng: np.random.Generator) -> np.ndarray:
    total = np.zeros_like(at[0])
    for step, radius in ((0.2, 9.0), (0.5, 16.0), (0.8, 26.0), (1.1, 34.0)):
        r = np.hypot(at[0] - 40.0 - 100.0 * step, at[1] - 40.0 - 50.0 * step)
        total += 35.0 * (r < radius) + 25.0 * (np.abs(r - radius) < 1.5)
    return total


def _stars(at: Grid, rng: np.random.Generator) -> np.ndarray:
    total = np.full_like(at[0], 8.0)
    for u, v, size in zip(rng.uniform(0, WIDTH, 150), rng.uniform(0, HEIGHT, 150), rng.pareto(1.2, 150), strict=True):
        total += 40.0 * size * np.exp(-((at[0] - u) ** 2 + (at[1] - v) ** 2))
    return total


def _trails(at: Grid, rng: np.random.Generator) -> np.ndarray:
    """Arcs about one pole outside the image: parallel circles, as cones of one axis are."""
    r, turn = np.hypot(at[0] - 96.0, at[1] + 60.0), np.arctan2(at[1] + 60.0, at[0] - 96.0)
    total = np.full_like(r, 8.0)
    for radius, begin in zip(rng.uniform(60.0, 210.0, 25), rng.uniform(0.6, 2.2, 25), strict=True):
        total += 120.0 * np.exp(-((r - radius) ** 2)) * (np.abs(turn - begin) < 0.4)
    return total


def _hot_pixels(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return _per_pixel(6.0 + 240.0 * (rng.random((HEIGHT, WIDTH)) < 0.003))


def _aurora(at: Grid, rng: np.random.Generator) -> np.ndarray:
    total = np.full_like(at[0], 6.0)
    for height, bend in ((40.0, 500.0), (62.0, 700.0), (75.0, 420.0)):
        v = height + (at[0] - 96.0) ** 2 / (2.0 * bend) + 4.0 * np.sin(at[0] / 9.0 + bend)
        total += 90.0 * np.where(at[1] < v, np.exp((at[1] - v) / 14.0), np.exp((v - at[1]) / 1.5))
    return total


def _baffle(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 150.0 * (at[1] - 0.15 * at[0] > 60.0)


def _crossing(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 90.0 * (at[1] > 60.0 + 0.2 * at[0]) + 90.0 * (at[0] > 90.0 + 0.3 * at[1])


def _ellipse(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 170.0 * (((at[0] - 96.0) / 80.0) ** 2 + ((at[1] - 72.0) / 45.0) ** 2 < 1.0)


def _rounded(at: Grid, half: tuple[float, float], corner: float) -> np.ndarray:
    x = np.clip(np.abs(at[0] - 92.0) - half[0] + corner, 0.0, None)
    y = np.clip(np.abs(at[1] - 74.0) - half[1] + corner, 0.0, None)
    return np.asarray(np.hypot(x, y) < corner)


def _solar_panel(at: Grid, rng: np.random.Generator) -> np.ndarray:
    cells = 1.0 - 0.25 * ((at[0] % 14.0 < 1.0) | (at[1] % 14.0 < 1.0))
    return 160.0 * _rounded(at, (72.0, 48.0), 30.0) * cells


def _text(at: Grid, rng: np.random.Generator) -> np.ndarray:
    glyphs = rng.random((HEIGHT // 4, WIDTH // 4)) < 0.5
    glyphs[::4] = False
    glyphs[:, ::4] = False
    return 200.0 * ~np.repeat(np.repeat(glyphs, 4 * FINE, axis=0), 4 * FINE, axis=1)


def _jpeg(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 100.0 + np.repeat(np.repeat(rng.integers(-3, 4, (HEIGHT // 8, WIDTH // 8)), 8 * FINE, 0), 8 * FINE, 1)


def _bands(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 100.0 + 60.0 * np.sign(np.sin(at[1] / 9.0)) + 0.0 * at[0]


def _half_black(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return _clouds(at, rng) * (at[1] > 71.5)


def _salt_and_pepper(at: Grid, rng: np.random.Generator) -> np.ndarray:
    some = rng.random((HEIGHT, WIDTH))
    return _per_pixel(np.where(some < 0.08, 0.0, np.where(some > 0.92, 255.0, 110.0)))


def _flare(at: Grid, rng: np.random.Generator) -> np.ndarray:
    """The image of a diaphragm with eight blades, and a smaller one."""
    total = np.full_like(at[0], 12.0)
    for u, v, size in ((80.0, 70.0, 48.0), (150.0, 110.0, 18.0)):
        x, y = at[0] - u, at[1] - v
        corner = np.pi / 4.0
        turn = np.mod(np.arctan2(y, x) + 0.1, corner) - 0.5 * corner
        total += 80.0 * (np.hypot(x, y) * np.cos(turn) < size * np.cos(0.5 * corner))
    return total


def _banana(at: Grid, rng: np.random.Generator) -> np.ndarray:
    r, turn = np.hypot(at[0] - 96.0, at[1] - 130.0), np.arctan2(130.0 - at[1], at[0] - 96.0)
    return (190.0 - 2.5 * (r - 60.0)) * ((r > 60.0) & (r < 95.0) & (np.abs(turn - 0.5 * np.pi) < 1.0))


def _bright_rings(at: Grid, rng: np.random.Generator) -> np.ndarray:
    """A disc that brightens to its limb in rings, as of a shell that shines."""
    angle = _angle(at, 96.0, 70.0)
    return (60.0 + 90.0 * (angle / 26.0) ** 6 + 25.0 * (angle > 23.0)) * (angle < 26.0) + 40.0 * (
        np.abs(angle - 30.0) < 0.8
    )


def _negative(draw: Draw) -> Draw:
    return lambda at, rng: 220.0 - draw(at, rng)


def _angle_of_ray(at: Grid) -> np.ndarray:
    """Angle [deg] from the nadir of the known attitude."""
    x, y = (at[0] - (WIDTH - 1) / 2) / FOCAL_PX, (at[1] - (HEIGHT - 1) / 2) / FOCAL_PX
    off = np.radians(NADIR_OFF_DEG)
    cosine = (y * np.sin(off) + np.cos(off)) / np.sqrt(x * x + y * y + 1.0)
    return np.degrees(np.arccos(cosine))


def _circle(at: Grid, rng: np.random.Generator) -> np.ndarray:
    return 10.0 + 180.0 * (np.abs(np.hypot(at[0] - 90.0, at[1] - 74.0) - 55.0) < 0.5)


def _double(at: Grid, rng: np.random.Generator) -> np.ndarray:
    """Two exposures of one limb, 12 px apart."""
    moved = (at[0] - 8.0, at[1] - 9.0)
    return 90.0 * (_angle_of_ray(at) < 68.0) + 90.0 * (_angle_of_ray(moved) < 68.0)


def _dust(at: Grid, rng: np.random.Generator) -> np.ndarray:
    total = np.full_like(at[0], 140.0)
    for u, v, radius in zip(rng.uniform(0, WIDTH, 12), rng.uniform(0, HEIGHT, 12), rng.uniform(8, 30, 12), strict=True):
        r = np.hypot(at[0] - u, at[1] - v)
        total -= 40.0 * ((r < radius) & (r > 0.4 * radius))
    return total


def _window(at: Grid, rng: np.random.Generator) -> np.ndarray:
    panes = (np.abs(at[0] - 96.0) > 4.0) & (np.abs(at[1] - 72.0) > 4.0)
    return 20.0 + 190.0 * panes * ((np.abs(at[0] - 96.0) < 70.0) & (np.abs(at[1] - 72.0) < 56.0))


def _porthole(at: Grid, rng: np.random.Generator) -> np.ndarray:
    """A round window with clouds behind it: a circle about the camera's axis."""
    return _clouds(at, rng) * (np.hypot(at[0] - 96.0, at[1] - 72.0) < 62.0)


_DRAWN: dict[str, tuple[Draw, bool]] = {
    "plain disc of 20 deg": (_disc(96.0, 70.0, 20.0), True),
    "plain disc of 55 deg, its edge": (_disc(96.0, 260.0, 50.0), True),
    "disc in a disc": (_two_discs, True),
    "crescent of 25 deg": (_crescent(25.0, 96.0, 72.0, 2.1), True),
    "hard vignette full of noise": (_vignette(60.0, 0.8, 40.0), True),
    "hard vignette full of faint noise": (_vignette(60.0, 0.8, 8.0), True),
    "vignette of 4 px full of noise": (_vignette(58.0, 4.0, 40.0), False),
    "vignette of 8 px full of noise": (_vignette(60.0, 8.0, 25.0), False),
    "vignette of 15 px off the middle": (_vignette(55.0, 15.0, 30.0, off=9.0), False),
    "noise of 2": (_noise(20.0, 2.0), False),
    "noise of 40": (_noise(120.0, 40.0), True),
    "gradient": (lambda at, rng: 20.0 + 0.8 * at[0] + 0.5 * at[1], False),
    "chequerboard": (lambda at, rng: 180.0 * ((at[0] // 12 + at[1] // 12) % 2), False),
    "stripes": (lambda at, rng: 90.0 + 80.0 * np.sign(np.sin((at[0] + 0.4 * at[1]) / 6.0)), True),
    "Moon of 0.5 deg": (_crescent(0.6, 96.0, 72.0, 0.4), False),
    "Moon of 10 deg": (_crescent(10.0, 80.0, 60.0, 1.2), True),
    "Moon of 40 deg": (_crescent(40.0, 96.0, 110.0, 1.9), True),
    "lamp with rings of glare": (_lamp, False),
    "ghosts": (_ghosts, True),
    "stars": (_stars, True),
    "trails of stars": (_trails, False),
    "clouds without space": (_clouds, True),
    "hot pixels": (_hot_pixels, False),
    "aurora": (_aurora, False),
    "edge of a baffle": (_baffle, False),
    "two edges that cross": (_crossing, True),
    "ellipse": (_ellipse, False),
    "solar panel": (_solar_panel, False),
    "text": (_text, False),
    "blocks of a flat field": (_jpeg, False),
    "bands": (_bands, False),
    "saturated": (lambda at, rng: 400.0 + 0.0 * at[0], True),
    "black": (lambda at, rng: 0.0 * at[0], False),
    "half black": (_half_black, False),
    "salt and pepper": (_salt_and_pepper, True),
    "lens flare": (_flare, False),
    "banana": (_banana, True),
    "disc with bright rings": (_bright_rings, True),
    "negative of a disc": (_negative(_disc(96.0, 70.0, 24.0)), True),
    "negative of a solar panel": (_negative(_solar_panel), False),
    "circle of one pixel": (_circle, False),
    "double limb": (_double, True),
    "dust": (_dust, False),
    "window": (_window, False),
    "porthole": (_porthole, True),
}


def pictures() -> Iterator[Picture]:
    """Draw them one after another, the same at every call."""
    fine = [(np.arange(n * FINE) + 0.5) / FINE - 0.5 for n in (WIDTH, HEIGHT)]
    at = np.meshgrid(*fine)
    seeds = np.random.SeedSequence(SEED).spawn(len(_DRAWN))
    for seed, (name, (draw, known)) in zip(seeds, _DRAWN.items(), strict=True):
        rng = np.random.default_rng(seed)
        drawn = np.broadcast_to(draw((at[0], at[1]), rng), (HEIGHT * FINE, WIDTH * FINE))
        clean = drawn.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3)) + 8.0
        noisy = clean + rng.normal(size=clean.shape) * np.sqrt(1.0 + 0.01 * np.clip(clean, 0.0, FULL_SCALE))
        image = np.zeros_like(clean) if name == "black" else np.clip(np.rint(noisy), 0.0, FULL_SCALE)
        yield Picture(name, image, known)
