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
from horizonval.core.outcome import Refusal
from horizonval.core.progress import Silent
from horizonval.estimation.fit.bundle import HEIGHT, Bundle, Shot, ShotPrior, Solved
from horizonval.estimation.fit.calibrate import ALL, FOCAL, POINT, Gathered, edges_of, profiles_of
from horizonval.estimation.fit.edge import FIXED_LENGTH_M, EdgeModel
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.pixels import pixel_at_limb_m
from horizonval.estimation.fit.solver import solve
from horizonval.estimation.methods.limb_ellipsoid import ESTIMATOR
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import WGS84
from horizonval.suites.observation import observation_of

SUITE = Path(__file__).with_name("calibration_bound.toml")
KNOWN_MODES = 1e-4
"""Of the relief's size: nothing."""
POINTS_PX = (20.0, 1.0, 0.1)
"""Of the principal point, as it comes from a data sheet, and from a bench."""
PROFILES = "profiles of the air of latitude and month"
TARGET_PERCENT = 0.02


def main(folder: Path, run: Path | None = None) -> None:
    """Write the page into a folder, of a run that is already there or of one that is made."""
    run = run or folder / "run"
    if not (run / "archive").exists():
        hv.run(SUITE, out=run)
    frames = told_rightly(run)
    edges = settled(edges_of(frames, Silent()))
    misplaced_m = MISPLACED_PX * float(
        np.median([pixel_at_limb_m(f.camera, f.prior.r_itrs, WGS84.a_m) for f in frames if f.prior.r_itrs is not None])
    )
    found = {"edges of unknown height": percents(edges)}
    for shot in edges.shots:
        with_known_air(shot)
    found["edges of known height, but for 0.05 px"] = percents(edges, misplaced_m)
    found["edges of known height"] = percents(edges, FIXED_LENGTH_M)
    profiles = settled(profiles_of(frames, Silent()))
    found[PROFILES] = percents(profiles)
    lines = [
        "# What an orbit's frames know of a focal length",
        "",
        f"The least standard deviation of the focal length [%], of {len(edges.shots)} infrared frames at",
        f"{len(edges.shots) // 2} places of an orbit, two at each with the body turned by 22 deg to either side, the",
        "camera told as it is (information of all pixels across the limb, and of the priors; Cramer and Rao).",
        "Attitudes are known to 18 arcsec, positions to 100 m, the mounting to 2 deg. Edges of known height are known",
        f"in depth and relief, too; {MISPLACED_PX:g} px are how far a rendered limb lies elsewhere in its pixels than",
        "such an edge. Whole profiles are those of the shipped tables, with what weather, haze and clouds leave open.",
        f"In brackets the frames that bring it to {TARGET_PERCENT:g} %, if it falls with the root of their number.",
        "",
        "| limbs | " + " | ".join(f"principal point to {point:g} px" for point in POINTS_PX) + " |",
        "|---|" + "---|" * len(POINTS_PX),
    ]
    for air, row in found.items():
        count = len((profiles if air == PROFILES else edges).shots)
        cells = [f"{percent:.4f} ({math.ceil(count * (percent / TARGET_PERCENT) ** 2)})" for percent in row]
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


def settled(gathered: Gathered | Refusal) -> Bundle:
    """Return images at their most probable pose, radiance and air, the camera as it is."""
    assert not isinstance(gathered, Refusal), gathered
    bundle, _ = gathered
    exact = bundle.sigmas.copy()
    exact[:HEIGHT] = 0.0
    solve(Bundle(bundle.shots, exact), ALL)
    return bundle


def with_known_air(shot: Shot) -> None:
    """Change what is known of a shot: height, depth and relief of its limb."""
    information = shot.prior.information.copy()
    information[-1, -1] = FIXED_LENGTH_M**-2.0
    shot.prior = ShotPrior(shot.prior.mean, information)
    assert shot.chosen is not None
    for model in shot.chosen.models:
        assert isinstance(model, EdgeModel)
        model.known = replace(model.known, scale_sigma_m=FIXED_LENGTH_M, middle_sigma_m=math.inf)
        model.pixels = replace(model.pixels, modes=KNOWN_MODES * model.pixels.modes)


def percents(bundle: Bundle, height_sigma_m: float | None = None) -> list[float]:
    """Return standard deviations of the focal length [%] by what is known of the principal point.

    ``height_sigma_m``: of the mean height of all limbs; None for the bundle's.
    """
    found = []
    for point_px in POINTS_PX:
        sigmas = bundle.sigmas.copy()
        sigmas[POINT] = point_px
        if height_sigma_m is not None:
            sigmas[HEIGHT] = height_sigma_m
        free = Bundle(bundle.shots, sigmas)
        equations = [shot.equations(free.shared, free.free) for shot in free.shots]
        found.append(100.0 * math.sqrt(Solved(free, equations).covariance[FOCAL, FOCAL]))
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out-calibration"), *map(Path, sys.argv[2:3]))
