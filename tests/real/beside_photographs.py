"""Frames of the whole Earth beside photographs of it: the same place, time and band.

    python tests/real/beside_photographs.py FOLDER results/real-earth

``FOLDER`` holds the photographs, which their makers let nobody pass on; what is written has our frames, and plots and
numbers of both. The photographs' geometry is in ``PHOTOGRAPHS``. Their tone curves are unknown: frames are encoded like
sRGB, and once more by one power for all channels, at the scale that gives the photograph's own 98th percentile, and
only shapes and ratios are compared. The power is fitted to the photograph's contrasts,

    p98 / p2 of DN = (p98 / p2 of radiance)^power,

one number for three contrasts: that the three agree on it is a test, its value is none.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

VISIBLE = {"blue": (0.43, 0.48), "green": (0.53, 0.57), "red": (0.64, 0.68)}
THERMAL = {"window": (11.9, 12.9)}
DISC = 0.97
"""Part of the apparent radius that counts as disc: inside the limb's softness."""
CENTRE, EDGE = (0.95, 1.0), (0.1, 0.2)
"""Cosines of the view angle, of the middle of the disc and of its edge."""
OF_A_CRESCENT = (0.5, 0.7)
"""The same in place of the middle, where the middle is night."""
LEAST_SUN = 0.3
"""Cosine of the Sun's zenith angle."""


@dataclass(frozen=True)
class Photograph:
    """A photograph and the scene it shows.

    ``radius_px``, ``centre_px``: of the Earth's outline; ``km_per_px`` at the limb; ``limb``: direction in the image
    [deg, from right to down] about which the limb's profile is taken, over 20 deg to either side.
    """

    file: str
    radius_px: float
    centre_px: tuple[float, float]
    km_per_px: float
    limb_deg: float
    scene: dict[str, Any]
    camera: dict[str, Any]
    thermal: bool = False
    sun_deg: tuple[float, float] | None = None
    """Where part of the disc is night: phase angle and direction of the Sun in the image; only pixels with the Sun
    :data:`LEAST_SUN` above the horizon are compared."""


def _geostationary(epoch: str) -> dict[str, Any]:
    return {
        "platform": {
            "altitude_km": 42164.16 - 6378.137,
            "latitude_deg": 0.0,
            "longitude_deg": 140.7,
            "epoch_utc": epoch,
        }
    }


PHOTOGRAPHS = {
    "epic": Photograph(
        "dscovr_epic_20250613T210604_1080.jpg",
        437.1,
        (539.5, 539.5),
        1.00631e-5 * 1_450_100.0,
        -35.0,
        {
            "platform": {
                "altitude_km": 1_450_100.0 - 6378.0,
                "latitude_deg": 19.0,
                "longitude_deg": -142.9,
                "epoch_utc": "2025-06-13T21:06:04Z",
            }
        },
        # half as many pixels: the photograph's limb is 4 pixels wide
        {"width": 540, "height": 540, "fx": 0.5 / 1.00631e-5, "fy": 0.5 / 1.00631e-5},
    ),
    "himawari-visible": Photograph(
        "himawari8_nict_truecolor_halflit_550.png",
        271.7,
        (274.5, 274.5),
        5.588799e-4 * 41_679.0,
        180.0,
        _geostationary("2016-04-08T09:20:00Z"),
        {"width": 550, "height": 550, "projection": "equal_angle", "fx": 1 / 5.588799e-4, "fy": 1 / 5.588799e-4},
        # subsolar point 7.3 deg north, 100.3 deg west of the satellite's
        sun_deg=(100.2, -172.6),
    ),
    "himawari-12um": Photograph(
        "himawari8_ahi_ir2_12um_20200920T1140_2750.jpg",
        1358.5,
        (1374.5, 1374.5),
        1.11775986e-4 * 41_679.0,
        0.0,
        _geostationary("2020-09-20T11:40:00Z"),
        {
            "width": 550,
            "height": 550,
            "projection": "equal_angle",
            "fx": 0.2 / 1.11775986e-4,
            "fy": 0.2 / 1.11775986e-4,
        },
        thermal=True,
    ),
}


def rendered(photograph: Photograph, clouds_seed: int | None = None) -> dict[str, FloatArray]:
    """Return the radiance of every band of a frame with everything that the Earth has."""
    kind, bands = ("thermal", THERMAL) if photograph.thermal else ("solar", VISIBLE)
    camera = CameraSpec.model_validate(
        {
            "camera": photograph.camera,
            "band": [{"name": n, "kind": kind, "lo_um": lo, "hi_um": hi} for n, (lo, hi) in bands.items()],
        }
    )
    scene = photograph.scene | {
        "scene": {"name": photograph.file},
        "camera": {"file": "photograph"},
        "atmosphere": {"profile": "by_latitude_month"},
        "surface": {"kind": "earth"},
        "clouds": {} if clouds_seed is None else {"seed": clouds_seed},
    }
    # east to the right, south down
    scene["platform"] = scene["platform"] | {"heading_deg": 90.0}
    frame = render_frame(SceneSpec.model_validate(scene), camera)
    return {band: radiance.astype(np.float64) for band, radiance in frame.radiance.items()}


def read(photograph: Photograph, folder: Path) -> dict[str, FloatArray]:
    """Return the photograph's channels in digital numbers; inverted where space is white."""
    image = cv2.imread(str(folder / photograph.file))
    if image is None:
        raise SystemExit(f"{folder / photograph.file}: no such photograph")
    if photograph.thermal:
        return {"window": 255.0 - image.mean(axis=2)}
    return {name: image[..., k].astype(np.float64) for k, name in enumerate(VISIBLE)}


def encoded(radiance: FloatArray, white: float) -> FloatArray:
    """Return digital numbers 0 to 255 of linear light, as sRGB encodes it."""
    x = np.clip(radiance / white, 0.0, 1.0)
    return 255.0 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def decoded(dn: float) -> float:
    """Return the linear light of a digital number, of white."""
    v = dn / 255.0
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def at_the_same_scale(
    radiance: FloatArray, photograph: FloatArray, disc: FloatArray, power: float | None = None
) -> FloatArray:
    """Return a frame's channel encoded so that the 98th percentiles of both discs agree; like sRGB, or by a power."""
    bright, goal = np.percentile(radiance[disc], 98), float(np.percentile(photograph[disc], 98))
    if power is None:
        return encoded(radiance, bright / decoded(goal))
    return np.minimum(goal * (np.maximum(radiance, 0.0) / bright) ** power, 255.0)


def contrast(channel: FloatArray, disc: FloatArray, least: float = 0.0) -> float:
    """Return the 98th over the 2nd percentile."""
    low, high = np.percentile(channel[disc], [2, 98])
    return float(high / max(low, least))


@dataclass(frozen=True)
class Grid:
    """Pixels by their distance from the outline's centre, in its radii, and by direction [deg]."""

    radius: FloatArray
    direction_deg: FloatArray

    @classmethod
    def of(cls, shape: tuple[int, ...], centre_px: tuple[float, float], radius_px: float) -> Grid:
        row, column = np.indices(shape[:2])
        x, y = (column - centre_px[0]) / radius_px, (row - centre_px[1]) / radius_px
        return cls(np.hypot(x, y), np.degrees(np.arctan2(y, x)))

    def day(self, sun_deg: tuple[float, float] | None) -> NDArray[np.bool_]:
        """Return where it is day; everywhere with the Sun behind the camera."""
        if sun_deg is None:
            return np.ones(self.radius.shape, dtype=bool)
        phase, towards = np.radians(sun_deg)
        across = self.radius * np.cos(np.radians(self.direction_deg) - towards)
        sun = across * np.sin(phase) + np.sqrt(np.maximum(1.0 - self.radius**2, 0.0)) * np.cos(phase)
        return np.asarray(sun > LEAST_SUN)

    def between(self, cosines: tuple[float, float]) -> NDArray[np.bool_]:
        """Return where the cosine of the view angle lies between limits."""
        mu = np.sqrt(np.maximum(1.0 - self.radius**2, 0.0))
        return (mu > cosines[0]) & (mu < cosines[1]) & (self.radius < 1.0)

    def limb(self, channel: FloatArray, towards_deg: float, radius_km: float) -> tuple[FloatArray, FloatArray]:
        """Return heights [km] and the mean profile of the limb over 20 deg to either side of a direction."""
        near = np.abs((self.direction_deg - towards_deg + 180.0) % 360.0 - 180.0) < 20.0
        height = (self.radius - 1.0) * radius_km
        edges = np.arange(-250.0, 250.0, 5.0)
        index = np.digitize(height[near], edges)
        values = channel[near]
        known = [k for k in range(1, len(edges)) if np.any(index == k)]
        return np.array([edges[k - 1] + 2.5 for k in known]), np.array([values[index == k].mean() for k in known])


def half_height_km(height: FloatArray, profile: FloatArray) -> float:
    """Return where a limb's profile falls to half of what it is 60 to 150 km below the outline."""
    inside = (height > -150.0) & (height < -60.0)
    dark = profile[height > 150.0].mean()
    share = (profile - dark) / (profile[inside].mean() - dark)
    k = int(np.flatnonzero((share[:-1] >= 0.5) & (share[1:] < 0.5))[-1])
    return float(height[k] + (share[k] - 0.5) / (share[k] - share[k + 1]) * (height[k + 1] - height[k]))


def edge_over_middle(photograph: Photograph, folder: Path, draws: int) -> dict[str, list[float]]:
    """Return edge over middle of the disc, like sRGB, over the photograph's, for as many draws of the month's clouds.

    The middle is a tenth of the disc: what stands there is one draw in a photograph, and another one in a frame.
    """
    theirs = read(photograph, folder)
    scale = photograph.camera["width"] / next(iter(theirs.values())).shape[1]
    centre = tuple((c + 0.5) * scale - 0.5 for c in photograph.centre_px)
    found: dict[str, list[float]] = {band: [] for band in theirs}
    for seed in range(1, draws + 1):
        for band, radiance in rendered(photograph, seed).items():
            small = cv2.resize(theirs[band], radiance.shape[::-1], interpolation=cv2.INTER_AREA)
            grid = Grid.of(radiance.shape, centre, photograph.radius_px * scale)
            frame = at_the_same_scale(radiance, small, grid.radius < DISC)
            ratios = [
                np.median(channel[grid.between(EDGE)]) / np.median(channel[grid.between(CENTRE)])
                for channel in (frame, small)
            ]
            found[band].append(float(ratios[0] / ratios[1]))
    return found


def compare(name: str, folder: Path, out: Path) -> dict[str, Any]:
    """Write a frame and its profiles, and return the numbers of both."""
    photograph = PHOTOGRAPHS[name]
    theirs, ours = read(photograph, folder), rendered(photograph)
    scale = photograph.camera["width"] / next(iter(theirs.values())).shape[1]
    centre = tuple((c + 0.5) * scale - 0.5 for c in photograph.centre_px)
    shape = next(iter(theirs.values())).shape
    grids = (
        Grid.of(shape, photograph.centre_px, photograph.radius_px),
        Grid.of(next(iter(ours.values())).shape, centre, photograph.radius_px * scale),
    )
    radius_km = photograph.radius_px * photograph.km_per_px
    days = tuple(grid.day(photograph.sun_deg) for grid in grids)
    discs = tuple((grid.radius < DISC) & day for grid, day in zip(grids, days, strict=True))
    small = {
        band: cv2.resize(photo, ours[band].shape[::-1], interpolation=cv2.INTER_AREA) for band, photo in theirs.items()
    }
    powers = {} if photograph.thermal else {band: _power(small[band], ours[band], discs[1]) for band in ours}
    power = float(np.mean(list(powers.values()))) if powers else None
    figures: dict[str, Any] = {}
    images: dict[str, FloatArray] = {}
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(ours), figsize=(4.2 * len(ours), 3.4), squeeze=False)
    for axis, (band, radiance) in zip(axes[0], ours.items(), strict=True):
        photo = theirs[band]
        if photograph.thermal:
            encodings = {"frame": 255.0 * radiance / np.percentile(radiance[discs[1]], 99)}
        else:
            encodings = {
                "frame": at_the_same_scale(radiance, small[band], discs[1]),
                "frame, one power": at_the_same_scale(radiance, small[band], discs[1], power),
            }
        images[band] = encodings["frame" if photograph.thermal else "frame, one power"]
        row: dict[str, Any] = {} if photograph.thermal else {"powers": {"own": powers[band], "all": power}}
        middle = CENTRE if photograph.sun_deg is None else OF_A_CRESCENT
        for whose, channel in {"photograph": photo, **encodings}.items():
            k = 0 if whose == "photograph" else 1
            grid, disc, day = grids[k], discs[k], days[k]
            height, profile = grid.limb(channel, photograph.limb_deg, radius_km)
            row[whose] = {
                "p98_over_p2": contrast(channel, disc, 1.0),
                "centre": float(np.median(channel[grid.between(middle) & day])),
                "edge": float(np.median(channel[grid.between(EDGE) & day])),
                "half_height_km": half_height_km(height, profile),
            }
            inside = profile[(height > -150.0) & (height < -60.0)].mean()
            style = {"photograph": ("0.4", "-"), "frame": ("C0", "-"), "frame, one power": ("C0", ":")}[whose]
            axis.plot(height, profile / inside, label=whose, color=style[0], linestyle=style[1])
        axis.set(title=f"{band}, limb", xlabel="height over the ellipsoid, km", xlim=(-150, 150), ylim=(-0.05, 1.25))
        axis.legend(frameon=False)
        figures[band] = row
    figure.tight_layout()
    figure.savefig(out / f"{name}-limb.png", dpi=110)
    plt.close(figure)
    stack = [images[band] for band in (("window",) * 3 if photograph.thermal else ("blue", "green", "red"))]
    cv2.imwrite(str(out / f"{name}.jpg"), np.clip(np.stack(stack, axis=-1), 0, 255).astype(np.uint8))
    return figures


def _power(photograph: FloatArray, radiance: FloatArray, disc: FloatArray) -> float:
    """Return the power of radiance that gives the photograph's contrast."""
    return float(np.log(contrast(photograph, disc, 1.0)) / np.log(contrast(radiance, disc)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", choices=sorted(PHOTOGRAPHS))
    parser.add_argument("--cloud-draws", type=int, default=0, help="edge over middle of EPIC's disc for so many")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    activate()
    if arguments.cloud_draws:
        for band, ratios in edge_over_middle(PHOTOGRAPHS["epic"], arguments.folder, arguments.cloud_draws).items():
            each = " ".join(f"{ratio - 1.0:+.0%}" for ratio in ratios)
            sys.stdout.write(f"{band:7s} mean {np.mean(ratios) - 1.0:+.1%} sd {np.std(ratios, ddof=1):.1%}  {each}\n")
        return
    names = [arguments.only] if arguments.only else list(PHOTOGRAPHS)
    figures = {name: compare(name, arguments.folder, arguments.out) for name in names}
    (arguments.out / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    for name, bands in figures.items():
        for band, row in bands.items():
            for whose, values in row.items():
                numbers = "  ".join(f"{key} {value:7.2f}" for key, value in values.items())
                sys.stdout.write(f"{name:18s} {band:7s} {whose:16s} {numbers}\n")


if __name__ == "__main__":
    main()
