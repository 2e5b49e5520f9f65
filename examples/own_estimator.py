"""A method of one's own beside a shipped one: python examples/own_estimator.py [FOLDER]

The method takes the steepest place of each column for the limb and fits a cone to the lines of sight. It is run on
frames at several latitudes, with several draws of the detector's noise, and its claims are tested.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

import horizonval as hv
from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import inverse, roll_pitch_of_nadir, rotate

NOISE_PX = 0.3
MODEL_RAD = np.radians(0.1)
"""Claimed for what the method leaves out: the Earth is no sphere, and the limb of the air is no edge."""
LATITUDES_DEG = (0.0, 30.0, 60.0)
DRAWS = 2


def steepest(observation: hv.Observation) -> hv.Fit | hv.Refusal:
    """Return the nadir from the limb's points, or say why there is none."""
    image = observation.image
    dark, bright = np.percentile(image, [1.0, 99.0])
    rise = np.diff(image, axis=0)
    columns = np.arange(image.shape[1])
    rows = np.clip(rise.argmax(axis=0), 1, len(rise) - 2)
    before, peak, after = (rise[rows + step, columns] for step in (-1, 0, 1))
    clear = (peak > 0.05 * (bright - dark)) & (peak > before) & (peak > after)
    if bright - dark < 20.0 or clear.sum() < 20:
        return hv.Refusal(hv.Outcome.NO_LIMB, "fewer than 20 columns with a clear edge")
    # The vertex of the parabola through three steps is where the limb is steepest.
    vertex = 0.5 * (before - after)[clear] / (before - 2.0 * peak + after)[clear]
    points = np.stack([columns[clear], rows[clear] + 0.5 + vertex], axis=-1)
    lines_of_sight = unproject(observation.camera, points)
    # Every u on the cone has u . n = cos(rho), hence u . m = 1 with m = n / cos(rho).
    m = np.linalg.lstsq(lines_of_sight, np.ones(len(points)), rcond=None)[0]
    nadir = m / np.linalg.norm(m)
    roll, pitch = roll_pitch_of_nadir(rotate(inverse(observation.q_cam_from_body), nadir))
    across = np.eye(3) - np.outer(nadir, nadir)
    return hv.Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=(NOISE_PX / observation.camera.fx) ** 2 * across,
        systematic_nadir_cam=MODEL_RAD**2 * across,
        roll_rad=float(roll),
        pitch_rad=float(pitch),
        points=points,
    )


def main(folder: Path) -> None:
    """Write ``scores.csv`` into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 160, "height": 160})
    base = hv.Scene(
        camera=camera,
        altitude_km=550,
        mount_roll_deg=65,
        render={"subsamples": 1, "nodes": 64, "orders": "single"},
    )
    with (folder / "scores.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["latitude_deg", "seed", "method", "status", "nadir_error_deg", "false_claim"])
        for latitude_deg in LATITUDES_DEG:
            frame = hv.render(base.changed(latitude_deg=latitude_deg), progress=False)
            for seed in range(DRAWS):
                image = frame.observe(seed=seed)
                for name, method in (("steepest", steepest), ("guarded", "guarded-altitude-free")):
                    score = hv.score(hv.estimate(image, method), frame)
                    table.writerow([latitude_deg, seed, name, score.status, score.nadir_error_deg, score.false_valid])
    print((folder / "scores.csv").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out-own-estimator"))
