"""What frames of one orbit know of a focal length (Cramer and Rao): python examples/calibration_bound.py [FOLDER [RUN]]

Runs `calibration_bound.toml` beside this file, or takes a run that is there, tells the methods the camera as it is, and
writes `bound.md` into the folder: the least standard deviation of the focal length that `calibrate` could claim of
edges of unknown and of known height and of whole profiles, with the principal point free and known.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import horizonval as hv
from horizonval.api.calibrate import images_of
from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.known import FIXED_LENGTH_M
from horizonval.estimation.fit.start import EllipsoidStart, ellipsoid_start, limb_height_prior
from horizonval.estimation.likelihood.calibration.edge_frame import EdgeFrame
from horizonval.estimation.likelihood.calibration.profile_frame import ProfileFrame
from horizonval.estimation.likelihood.calibration.shared import (
    FOCAL,
    HEIGHT,
    POINT,
    SHARED,
    SharedUnknowns,
    prior_sigmas,
)
from horizonval.estimation.likelihood.profile.known_profile import KnownProfile, known_profile
from horizonval.estimation.methods.limb_ellipsoid import ESTIMATOR
from horizonval.estimation.observation import Observation
from horizonval.suites.observation import observation_of

SUITE = Path(__file__).with_name("calibration_bound.toml")
ROUNDS = 5
"""In which every frame settles with the camera as it is, before its information is taken."""
KNOWN_MODES = 1e-4
"""Of the relief's size: nothing."""
POINTS_PX = (20.0, 1.0, 0.1)
"""Of the principal point, as it comes from a data sheet, and from a bench."""
AIRS = {
    "edges of unknown height": None,
    "edges of known height, but for 0.05 px": MISPLACED_PX,
    "edges of known height": 0.0,
}
PROFILES = "profiles of the air of latitude and month"
TARGET_PERCENT = 0.02


def main(folder: Path, run: Path | None = None) -> None:
    """Write the page into a folder, of a run that is already there or of one that is made."""
    run = run or folder / "run"
    if not (run / "archive").exists():
        hv.run(SUITE, out=run)
    frames = told_rightly(run)
    settled = settle(frames)
    misplaced = MISPLACED_PX * float(np.median([f.pixel_m for f in settled]))
    sigmas = prior_sigmas(frames[0], float(np.hypot(limb_height_prior(frames[0])[1], misplaced)))
    lines = [
        "# What an orbit's frames know of a focal length",
        "",
        f"The least standard deviation of the focal length [%], of {len(settled)} infrared frames at",
        f"{len(settled) // 2} places of an orbit, two at each with the body turned by 22 deg to either side, the",
        "camera told as it is (information of all pixels across the limb, and of the priors; Cramer and Rao).",
        "Attitudes are known to 18 arcsec, positions to 100 m, the mounting to 2 deg. Edges of known height are known",
        f"in depth and relief, too; {MISPLACED_PX:g} px are how far a rendered limb lies elsewhere in its pixels than",
        "such an edge. Whole profiles are those of the shipped tables, with what weather, haze and clouds leave open.",
        f"In brackets the frames that bring it to {TARGET_PERCENT:g} %, if it falls with the root of their number.",
        "",
        "| limbs | " + " | ".join(f"principal point to {point:g} px" for point in POINTS_PX) + " |",
        "|---|" + "---|" * len(POINTS_PX),
    ]
    heights = {air: float(sigmas[HEIGHT]) if px is None else FIXED_LENGTH_M for air, px in AIRS.items()}
    found = {air: information(settled, px) for air, px in AIRS.items()}
    profiles, used = of_profiles(frames)
    found[PROFILES], heights[PROFILES] = profiles, hv.Prior().air_height_sigma_m
    for air, matrix in found.items():
        count = used if air == PROFILES else len(settled)
        cells = []
        for point in POINTS_PX:
            percent = 100.0 * focal_sigma(matrix, sigmas, point, heights[air])
            cells.append(f"{percent:.4f} ({math.ceil(count * (percent / TARGET_PERCENT) ** 2)})")
        lines.append(f"| {air} | " + " | ".join(cells) + " |")
    lines += ["", "Made by `python examples/calibration_bound.py results/calibration`."]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bound.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


def told_rightly(run: Path) -> list[Observation]:
    """Return what the images say to a method that is told the camera as it is."""
    made = []
    for path in images_of([run]):
        image = hv.open_image(path)
        scene = {key: value for key, value in image.truth.scene.items() if key != "calibration"}
        made.append(observation_of(replace(image, truth=replace(image.truth, scene=scene)), ESTIMATOR))
    return made


def settle(frames: list[Observation]) -> list[EdgeFrame]:
    """Return the frames at their most probable pose, light and air."""
    settled = []
    for observation in frames:
        start = ellipsoid_start(observation, "limb-calibrate")
        if not isinstance(start, EllipsoidStart):
            continue
        frame = EdgeFrame(start, observation.camera)
        for _ in range(ROUNDS):
            frame.equations(SharedUnknowns(np.zeros(SHARED)), held=False)
            frame.step(np.zeros(SHARED))
        frame.equations(SharedUnknowns(np.zeros(SHARED)), held=False)
        settled.append(frame)
    return settled


def information(settled: list[EdgeFrame], place_px: float | None) -> FloatArray:
    """Return the normal matrix (8, 8) of what frames share; with the air known but for its place in the pixels."""
    total = np.zeros((SHARED, SHARED))
    for frame in settled:
        knowledge, near = frame.knowledge, frame.near
        if place_px is not None:
            priors = knowledge.information.copy()
            priors[-1, -1] = max(place_px * frame.pixel_m, FIXED_LENGTH_M) ** -2.0
            frame.knowledge = replace(
                knowledge, information=priors, scale_sigma_m=FIXED_LENGTH_M, middle_sigma_m=math.inf
            )
            frame.near = replace(near, modes=KNOWN_MODES * near.modes)
        total += frame.equations(SharedUnknowns(np.zeros(SHARED)), held=True)[0]
        frame.knowledge, frame.near = knowledge, near
    return total


def of_profiles(frames: list[Observation]) -> tuple[FloatArray, int]:
    """Return the normal matrix (8, 8) of whole profiles of the limb, and how many frames are in it."""
    total, used, told = np.zeros((SHARED, SHARED)), 0, SharedUnknowns(np.zeros(SHARED))
    for observation in frames:
        known = known_profile(observation, "limb-calibrate")
        assert isinstance(known, KnownProfile)
        frame = ProfileFrame(known, observation.camera, 0.0)
        for _ in range(ROUNDS):
            frame.equations(told, held=False)
            frame.step(np.zeros(SHARED))
        total += frame.equations(told, held=True)[0]
        used += 1
    return total, used


def focal_sigma(found: FloatArray, sigmas: FloatArray, point_px: float, height_sigma_m: float) -> float:
    """Return the standard deviation of ln f, with priors of what is shared."""
    prior = sigmas.copy()
    prior[POINT], prior[HEIGHT] = point_px, height_sigma_m
    inverse = np.linalg.inv(np.eye(SHARED) + found * np.outer(prior, prior))
    return float(math.sqrt(inverse[FOCAL, FOCAL]) * prior[FOCAL])


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out-calibration"), *map(Path, sys.argv[2:3]))
