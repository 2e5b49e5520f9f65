"""What the fit of the limb's whole profile reaches where the air is known: python examples/right_air.py [FOLDER]

Runs the suite `right-air`, which fits with the shipped tables of the climate; makes a table of the very air for every
band, fits the same images with it, and prints both. A folder that has the frames is not rendered again.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean, median

import horizonval as hv

SUITE, AIR, ESTIMATOR = "right-air", "us_standard", "limb-profile"
PRIOR = """[prior]
position_sigma_km = 1.0
attitude_sigma_deg = [2.0, 2.0, 2.0]
climate = "{table}"
"""
"""That of the suite but for the air; the errors that are drawn from it are the same."""


def main(folder: Path) -> None:
    """Make everything in ``folder``."""
    run = hv.run(SUITE, out=folder / "run")
    print(f"{'band':11} {'pixels':>6} {'air':11} {'frames':>6} {'refused':>7}", end=" ")
    print(f"{'median':>6} {'rms':>6} {'largest':>7} {'NEES':>5}")
    images: dict[str, list[Path]] = {}
    for band, address in run.rows().project('band, image_address, "case"').order('"case"').project("#1, #2").fetchall():
        images.setdefault(band, []).append(folder / "run" / "archive" / address[:2] / f"{address}.exr")
    for band in sorted(images):
        for air, prior in (("climate", None), (AIR, prior_of(band, folder))):
            scores: dict[int, list[hv.Score]] = {}
            for image in map(hv.open_image, images[band]):
                score = hv.score(hv.estimate(image, ESTIMATOR, prior=prior), image)
                scores.setdefault(image.dn.shape[1], []).append(score)
            for width in sorted(scores):
                report(band, width, air, scores[width])


def prior_of(band: str, folder: Path) -> Path:
    """Return the file of a prior that names a table of the air, which is made."""
    table, prior = folder / f"{band}.npz", folder / f"{band}.toml"
    asked = [SUITE, "--band", band, "--air", AIR, "--clear", "--error", "0.001", "-o", str(table)]
    subprocess.run(["horizonval", "templates", *asked], check=True, stdout=subprocess.DEVNULL)
    prior.write_text(PRIOR.format(table=table.name), encoding="utf-8")
    return prior


def report(band: str, width: int, air: str, scores: Sequence[hv.Score]) -> None:
    """Print the errors of the nadir [arcsec], and their squares over what is claimed and expected: 1 where it holds."""
    errors = known(score.nadir_error_arcsec for score in scores)
    squares = known(score.nees_nadir_total for score in scores)
    rms = math.sqrt(fmean(error**2 for error in errors))
    print(
        f"{band:11} {width:6} {air:11} {len(scores):6} {len(scores) - len(errors):7} {median(errors):6.0f} {rms:6.0f} "
        f"{max(errors):7.0f} {fmean(squares) / 2.0:5.1f}"
    )


def known(values: Iterable[float | None]) -> list[float]:
    """Return what an answer has of a score: a refusal has none."""
    return [value for value in values if value is not None]


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out-right-air"))
