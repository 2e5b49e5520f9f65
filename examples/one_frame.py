"""One frame from scene to score: python examples/one_frame.py [FOLDER]

Renders a limb, makes a detector image of it, estimates the nadir with two methods, and keeps frame and image as files.
"""

from __future__ import annotations

import sys
from pathlib import Path

import horizonval as hv


def main(folder: Path) -> None:
    """Make everything in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 256, "height": 256})
    scene = hv.Scene(
        camera=camera,
        altitude_km=550,
        latitude_deg=10,
        epoch_utc="2026-03-20T12:00Z",
        mount_roll_deg=65,
        surface={"kind": "earth"},
        render={"subsamples": 1, "nodes": 64},
    )
    frame = hv.render(scene, progress=False)
    frame.save(folder / "frame.exr")
    image = frame.observe(seed=1)
    image.save(folder / "image.exr")
    print(frame)
    print(image)
    for name in ("altitude-free", "guarded-altitude-free"):
        answer = hv.estimate(image, name)
        score = hv.score(answer, frame)
        print(f"{name}: {score.status}, nadir {score.nadir_error_deg:.3f} deg off, false claim: {score.false_valid}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out-one-frame"))
