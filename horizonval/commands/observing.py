"""Many detector images of one stored frame: seeds, exposures and bands, and a name for each image.

Numbers are written as lists and ranges (``3``, ``0-9``, ``1,4,7-9``). The output is the path of one file; a pattern
with ``{seed}``, ``{exposure}``, ``{band}`` for several; or a folder (a path without an ending), whose files are named
after what differs.
"""

from __future__ import annotations

import itertools
import re
import string
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from horizonval.core.errors import UserError
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import LONGEST_EXPOSURE_S, Cmos

MOST_IMAGES = 10_000
FIELDS = ("band", "exposure", "seed")


@dataclass(frozen=True)
class ImagePlan:
    """One image to make. ``exposure_s`` is None where the camera file decides, ``band`` where it is the first one."""

    path: Path
    seed: int
    exposure_s: float | None
    band: str | None

    def camera(self, camera: CameraSpec) -> CameraSpec:
        """Return the camera with this exposure, automatic exposure off."""
        if self.exposure_s is None or camera.detector is None:
            return camera
        changes = {"exposure_s": self.exposure_s, "auto_exposure": None}
        return camera.model_copy(update={"detector": camera.detector.model_copy(update=changes)})


def plans(
    out: str, seeds: Sequence[str], exposures: Sequence[str], bands: Sequence[str], camera: CameraSpec
) -> list[ImagePlan]:
    """Return the images that options ask for, one for every combination.

    Parameters
    ----------
    out : str
        Path, pattern or folder.
    seeds, exposures, bands : sequence of str
        As given, each one a list; empty for seed 0, the camera's own exposure, its first band.
    camera : CameraSpec

    Raises
    ------
    UserError
        Text that is no number, an exposure for a detector without one, a pattern that does not tell the images apart.
    """
    chosen_seeds = _seeds(seeds) or [0]
    chosen_exposures: Sequence[float | None] = _exposures(exposures, camera) or [None]
    chosen_bands: Sequence[str | None] = list(dict.fromkeys(_split(bands))) or [None]
    count = len(chosen_seeds) * len(chosen_exposures) * len(chosen_bands)
    if count > MOST_IMAGES:
        raise UserError(f"{count} images", where="--seed", expected=f"at most {MOST_IMAGES} in one command")
    several = {"band": len(chosen_bands) > 1, "exposure": len(chosen_exposures) > 1, "seed": len(chosen_seeds) > 1}
    pattern = _pattern(out, [name for name in FIELDS if several[name]], count)
    images = [
        ImagePlan(Path(_filled(pattern, camera, band, exposure, seed)), seed, exposure, band)
        for band, exposure, seed in itertools.product(chosen_bands, chosen_exposures, chosen_seeds)
    ]
    paths: set[Path] = set()
    for plan in images:
        if plan.path in paths:
            raise UserError(f"two images would be called {str(plan.path)!r}", where="--out")
        paths.add(plan.path)
    return images


def _split(texts: Sequence[str]) -> list[str]:
    return [part.strip() for text in texts for part in text.split(",")]


def _seeds(texts: Sequence[str]) -> list[int]:
    seeds: dict[int, None] = {}
    for part in _split(texts):
        match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if last < first:
            raise UserError(f"found {part!r}", where="--seed", expected="numbers from 0 up, or ranges such as 0-9")
        if last - first >= MOST_IMAGES:
            raise UserError(f"{part} are too many", where="--seed", expected=f"at most {MOST_IMAGES} in one command")
        seeds |= dict.fromkeys(range(first, last + 1))
    return list(seeds)


def _exposures(texts: Sequence[str], camera: CameraSpec) -> list[float]:
    exposures: dict[float, None] = {}
    for part in _split(texts):
        try:
            seconds = float(part)
        except ValueError:
            seconds = -1.0
        if not 0 < seconds <= LONGEST_EXPOSURE_S:
            raise UserError(
                f"found {part!r}",
                where="--exposure",
                expected=f"seconds above 0 and of at most {LONGEST_EXPOSURE_S:g}, such as 1e-3",
            )
        exposures[seconds] = None
    if exposures and not isinstance(camera.detector, Cmos):
        kind = "no detector" if camera.detector is None else f"a detector of kind {camera.detector.kind!r}"
        raise UserError(f"the camera has {kind}, which has no exposure", where="--exposure", fix="leave it out")
    return list(exposures)


def _pattern(out: str, differ: Sequence[str], count: int) -> str:
    """Return the pattern of the files' names; a folder gets one after what differs."""
    try:
        fields = [name for _, name, _, _ in string.Formatter().parse(out) if name is not None]
    except ValueError as e:
        raise UserError(f"found {out!r}", where="--out", expected="{seed}, {exposure}, {band} or none") from e
    unknown = [name for name in fields if name not in FIELDS]
    if unknown:
        raise UserError(
            f"found {{{unknown[0]}}}", where="--out", expected=" or ".join(f"{{{name}}}" for name in FIELDS)
        )
    if differ and not fields and (Path(out).is_dir() or not Path(out).suffix):
        return str(Path(out) / ("-".join(f"{{{name}}}" for name in differ) + ".exr"))
    missing = [name for name in differ if name not in fields]
    if missing:
        fix = " and ".join(f"{{{name}}}" for name in missing)
        raise UserError(
            f"{count} images would overwrite each other in {out!r}",
            where="--out",
            fix=f"put {fix} into the name, or name a folder",
        )
    return out


def _filled(pattern: str, camera: CameraSpec, band: str | None, exposure_s: float | None, seed: int) -> str:
    detector = camera.detector
    seconds = exposure_s or (detector.exposure_s if isinstance(detector, Cmos) else 0.0)
    name = band or (camera.band[0].name if camera.band else "")
    try:
        return pattern.format(band=name, exposure=f"{seconds:.9g}", seed=seed)
    except ValueError as e:
        raise UserError(f"found {pattern!r}: {e}", where="--out", expected="{seed}, {exposure}, {band}") from e
