"""Frames of the whole Earth beside photographs of it: the same place, time and band.

    python tests/real/beside_photographs.py FOLDER results/real-earth

``FOLDER`` holds the photographs, which their makers let nobody pass on; what is written has our frames, and plots and
numbers of both. The photographs' geometry is in ``PHOTOGRAPHS``. Their tone curves are unknown: frames are encoded like
sRGB, at the scale that gives the photograph's own 98th percentile, and only shapes and ratios are compared.
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

from horizonval.core.arrays import FloatArray
from horizonval.renderer.plugin.backend import activate
from horizonval.renderer.scene.frame import render_frame
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

VISIBLE = {"blue": (0.43, 0.48), "green": (0.53, 0.57), "red": (0.64, 0.68)}
THERMAL = {"window": (11.9, 12.9)}
DISC = 0.97
"""Part of the apparent radius that counts as disc: inside the limb's softness."""
CENTRE, EDGE = (0.95, 1.0), (0.1, 0.2)
"""Cosines of the view angle, of the middle of the disc and of its edge."""


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
        {"width": 1080, "height": 1080, "fx": 1.0 / 1.00631e-5, "fy": 1.0 / 1.00631e-5},
    ),
    "himawari-visible": Photograph(
        "himawari8_nict_truecolor_halflit_550.png",
        271.7,
        (274.5, 274.5),
        5.588799e-4 * 41_679.0,
        180.0,
        _geostationary("2016-04-08T09:20:00Z"),
        {"width": 550, "height": 550, "projection": "equal_angle", "fx": 1 / 5.588799e-4, "fy": 1 / 5.588799e-4},
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


def rendered(photograph: Photograph) -> dict[str, FloatArray]:
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
        "clouds": {},
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


def at_the_same_scale(radiance: FloatArray, photograph: FloatArray, disc: FloatArray) -> FloatArray:
    """Return a frame's channel encoded so that the 98th percentiles of both discs agree."""
    white = np.percentile(radiance[disc], 98) / decoded(float(np.percentile(photograph[disc], 98)))
    return encoded(radiance, white)


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

    @property
    def disc(self) -> FloatArray:
        return self.radius < DISC

    def between(self, cosines: tuple[float, float]) -> FloatArray:
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
    figures: dict[str, Any] = {}
    images: dict[str, FloatArray] = {}
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(ours), figsize=(4.2 * len(ours), 3.4), squeeze=False)
    for axis, (band, radiance) in zip(axes[0], ours.items(), strict=True):
        photo = theirs[band]
        if photograph.thermal:
            images[band] = 255.0 * radiance / np.percentile(radiance[grids[1].disc], 99)
        elif photograph.limb_deg == 180.0:
            images[band] = encoded(radiance, np.percentile(radiance[grids[1].disc], 98) / decoded(132.0))
        else:
            small = cv2.resize(photo, radiance.shape[::-1], interpolation=cv2.INTER_AREA)
            images[band] = at_the_same_scale(radiance, small, grids[1].disc)
        row: dict[str, Any] = {}
        for whose, grid, channel in zip(("photograph", "frame"), grids, (photo, images[band]), strict=True):
            height, profile = grid.limb(channel, photograph.limb_deg, radius_km)
            low, high = np.percentile(channel[grid.disc], [2, 98])
            row[whose] = {
                "p98_over_p2": float(high / max(low, 1.0)),
                "centre": float(np.median(channel[grid.between(CENTRE)])),
                "edge": float(np.median(channel[grid.between(EDGE)])),
                "half_height_km": half_height_km(height, profile),
            }
            inside = profile[(height > -150.0) & (height < -60.0)].mean()
            axis.plot(height, profile / inside, label=whose, color={"photograph": "0.4", "frame": "C0"}[whose])
        axis.set(title=f"{band}, limb", xlabel="height over the ellipsoid, km", xlim=(-150, 150), ylim=(-0.05, 1.25))
        axis.legend(frameon=False)
        figures[band] = row
    figure.tight_layout()
    figure.savefig(out / f"{name}-limb.png", dpi=110)
    plt.close(figure)
    stack = [images[band] for band in (("window",) * 3 if photograph.thermal else ("blue", "green", "red"))]
    cv2.imwrite(str(out / f"{name}.png"), np.clip(np.stack(stack, axis=-1), 0, 255).astype(np.uint8))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", choices=sorted(PHOTOGRAPHS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    activate()
    names = [arguments.only] if arguments.only else list(PHOTOGRAPHS)
    figures = {name: compare(name, arguments.folder, arguments.out) for name in names}
    (arguments.out / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    for name, bands in figures.items():
        for band, row in bands.items():
            for whose, values in row.items():
                numbers = "  ".join(f"{key} {value:7.2f}" for key, value in values.items())
                sys.stdout.write(f"{name:18s} {band:7s} {whose:11s} {numbers}\n")


if __name__ == "__main__":
    main()
