"""The picture at the head of README.md: python docs/make_limbs.py results/gallery/limbs.jpg

Six of the shipped scenes, rendered larger and wider: four in three colours of visible light, two in the infrared.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import matplotlib
import numpy as np

import horizonval as hv
from horizonval.api.gallery import LIMITS_UM
from horizonval.earth.spectral.planck import brightness_temperature_k

WIDTH, HEIGHT, GAP = 480, 300, 6
VISIBLE = ("broken-clouds", "terminator", "glint", "twilight-06")
INFRARED = {"ir-cold-cloud": "window", "ir-limb-equinox": "window"}
INFRARED_K = (210.0, 300.0)
ORDER = ("broken-clouds", "terminator", "ir-cold-cloud", "twilight-06", "glint", "ir-limb-equinox")
QUICK = {"subsamples": 1, "nodes": 64}


def visible(name: str) -> np.ndarray:
    """Return a scene in colour, shape (HEIGHT, WIDTH, 3)."""
    scene = hv.Scene.from_file(name)
    data = scene.camera.to_dict()
    data["camera"] = {"name": data["camera"]["name"], "width": WIDTH, "height": HEIGHT, "fov_deg": 60.0}
    data["band"] = [{"name": band, "kind": "solar", "lo_um": lo, "hi_um": hi} for band, (lo, hi) in LIMITS_UM.items()]
    data.pop("detector", None)
    return hv.render(scene.changed(camera=hv.Camera.from_dict(data), render=QUICK)).picture()


def infrared(name: str, band_name: str) -> np.ndarray:
    """Return one band of a scene as brightness temperatures in colours, shape (HEIGHT, WIDTH, 3)."""
    scene = hv.Scene.from_file(name)
    data = scene.camera.to_dict()
    data["camera"] |= {"width": WIDTH, "height": HEIGHT, "fx": None, "fy": None, "cx": None, "cy": None}
    data["camera"]["fov_deg"] = 60.0
    data["camera"].pop("focal_length_mm", None)
    data["band"] = [band for band in data["band"] if band["name"] == band_name]
    data.pop("detector", None)
    frame = hv.render(scene.changed(camera=hv.Camera.from_dict(data), render=QUICK))
    band = frame.camera.spec.band[0]
    kelvin = brightness_temperature_k(band, frame.radiance[band_name])
    low, high = INFRARED_K
    colours = matplotlib.colormaps["inferno"](np.clip((kelvin - low) / (high - low), 0.0, 1.0))
    return np.round(255 * colours[..., :3]).astype(np.uint8)


def main(path: Path) -> None:
    """Write the picture."""
    pictures = {name: visible(name) for name in VISIBLE}
    pictures |= {name: infrared(name, band) for name, band in INFRARED.items()}
    whole = np.full((2 * HEIGHT + GAP, 3 * WIDTH + 2 * GAP, 3), 255, np.uint8)
    for i, name in enumerate(ORDER):
        top, left = (i // 3) * (HEIGHT + GAP), (i % 3) * (WIDTH + GAP)
        whole[top : top + HEIGHT, left : left + WIDTH] = pictures[name]
    cv2.imwrite(str(path), whole[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
