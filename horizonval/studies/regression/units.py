"""Units of a night: a scene rendered and observed with every noise seed, or the frozen images of one replayed.

Images become rows as in any suite (:mod:`horizonval.suites.units.scored`), one row for every replicate. Each head of a
scene is rendered, observed and frozen separately; methods that see all heads get the images of one replicate together.
Results are stored under the digest of content and code, so the same command resumes.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.cache import is_intact, read_arrays, write_arrays
from horizonval.core.code import code_digest
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.jobs.engine import Record, Recorded
from horizonval.jobs.progress import Stopwatch
from horizonval.scoring.bound import bound_of
from horizonval.scoring.information import KEY, information_of
from horizonval.scoring.row import rounded
from horizonval.sensor.expected_image import radiance_per_dn
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import Case
from horizonval.spec.scene import SceneSpec
from horizonval.studies.regression.baseline import FrozenImage, Pack, digest, read_pack
from horizonval.studies.regression.images import noise_in_space, regions_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.suites.identity import code_of, unit_identity
from horizonval.suites.plan import CasePlan, Unit
from horizonval.suites.record import camera_name
from horizonval.suites.units.scored import Observed, score_alone, score_together

Shown = tuple[tuple[str, float | None], ...]
"""Input of an estimator: for every head the digest of the image, and the band radiance of a digital number or None."""
Heads = Mapping[str, Observed]
"""One image of every head of a scene, by name in the camera file's order."""


def render_unit(
    unit: Unit, plan: CasePlan, replicates: int, known: frozenset[Shown] = frozenset()
) -> tuple[Record, dict[str, np.ndarray]]:
    """Return the record and the arrays of a unit: rendered, observed with every noise seed, and estimated.

    ``known``: inputs that are answered already; estimators do not run on them again.

    Returns
    -------
    record : dict
        ``scenes``: by case ``{table, camera, truth, bands}``, with ``{radiance_sha256, expected, borderline,
        bound_arcsec, full_scale, images, radiance_per_dn, noise_dn}`` by band. ``together``: the same of methods that
        see all heads, ``{table, heads, bands}`` by scene, where ``heads`` are the names and cases of the heads and a
        band has ``{expected, borderline, bound_arcsec, images}``. ``rows``: :class:`ReplicateRow`, plain.
    arrays : dict of ndarray
        ``<case>:radiance.<band>`` (float32), ``<case>:regions``, ``<case>:dn.<band>.<seed>``.
    """
    scenes: dict[str, Any] = {}
    together: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    rows: list[ReplicateRow] = []
    observed: dict[str, dict[str, list[Observed]]] = {}
    table = unit.cases[0].table or ""
    for case in unit.cases:
        frame = _render(case.scene, case.camera)
        bands, images, made = _observe_case(case, frame, replicates)
        observed[str(case.head)] = images
        truth = replace(frame.truth, infrared_horizon={}).to_dict()
        scenes[case.name] = {"table": table, "camera": camera_name(case), "truth": truth, "bands": bands}
        arrays |= {f"{case.name}:{name}": values for name, values in made.items()}
        for replicate, one in ((k, one) for of_band in images.values() for k, one in enumerate(of_band)):
            if shown([one]) not in known:
                rows += _alone(one, case.name, replicate, table, plan)
    if unit.heads:
        bands = {}
        for band in next(iter(observed.values())):
            if any(band not in images for images in observed.values()):
                continue
            digests: list[str] = []
            for replicate in range(replicates):
                heads = {head: images[band][replicate] for head, images in observed.items()}
                wanted = plan if shown(heads.values()) not in known else replace(plan, estimators=())
                scene, found = _together(heads, unit.name, replicate, table, wanted)
                rows += found
                digests.append(digest_of_heads(heads))
            bands[band] = {**_about(scene, band, "heads"), "images": digests}
        names = [[str(case.head), case.name] for case in unit.cases]
        together[unit.name] = {"table": table, "heads": names, "bands": bands}
    return {"scenes": scenes, "together": together, "rows": [row.to_dict() for row in rows]}, arrays


def _render(scene: SceneSpec, camera: CameraSpec) -> RadianceFrame:
    from horizonval.renderer.frame import render_in_turn

    return render_in_turn(scene, camera)


def _observe_case(
    case: Case, frame: RadianceFrame, replicates: int
) -> tuple[dict[str, Any], dict[str, list[Observed]], dict[str, np.ndarray]]:
    """Return the bands' records of a frame, every band's images, and the arrays."""
    regions = regions_of(frame.maps["hit"], frame.maps["tangent_height"])
    arrays: dict[str, np.ndarray] = {"regions": regions}
    bands: dict[str, Any] = {}
    observed: dict[str, list[Observed]] = {}
    for band in (one.name for one in case.camera.band):
        clean = observe(frame, case.camera, band=band, seed=0, noise=False).dn
        images = [observe(frame, case.camera, band=band, seed=seed) for seed in range(replicates)]
        # The information depends on the frame only, not on the noise sample.
        information = information_of(frame, case.camera, band)
        carried = {KEY: None if information is None else information.to_dict()}
        images = [replace(image, observation={**image.observation, **carried}) for image in images]
        observed[band] = _of_one_frame(images)
        observed[band][0].bounds[band] = bound_of(information, frame.truth, band)
        noise = [noise_in_space(image.dn, clean, regions) for image in images]
        known_noise = [value for value in noise if value is not None]
        arrays[f"radiance.{band}"] = frame.radiance[band]
        arrays |= {f"dn.{band}.{seed}": image.dn for seed, image in enumerate(images)}
        bands[band] = {
            "radiance_sha256": digest(frame.radiance[band]),
            **_about(observed[band][0], band, "image"),
            "full_scale": images[0].full_scale,
            "images": [digest(image.dn) for image in images],
            "radiance_per_dn": [radiance_per_dn(image) for image in images],
            "noise_dn": math.sqrt(float(np.mean(np.square(known_noise)))) if known_noise else None,
        }
    return bands, observed, arrays


def _of_one_frame(images: Iterable[DetectorImage]) -> list[Observed]:
    """Return images of one frame with different noise, sharing values derived from the truth."""
    first = Observed({})
    return [Observed({image.band: image}, expected=first.expected, bounds=first.bounds) for image in images]


def _about(observed: Observed, band: str, needs: Any) -> dict[str, Any]:
    """Return the expected outcomes of a band, and the bound of its limb."""
    expected, bound = observed.expected_of(band, needs), observed.bound(band)
    return {
        "expected": str(expected.outcome),
        "borderline": expected.borderline,
        "bound_arcsec": None if bound is None else rounded("bound_arcsec", bound.known_arcsec),
    }


def _alone(observed: Observed, scene: str, replicate: int, table: str, plan: CasePlan) -> list[ReplicateRow]:
    """Return a row for each estimator of one image."""
    names = [name for name in plan.estimators if plan.estimator(name).needs != "heads"]
    rows = replace(observed, rows=[], details={})
    score_alone(rows, scene, names, plan, Stopwatch())
    (image,) = observed.images.values()
    return [ReplicateRow.of(row, replicate=replicate, table=table, image=digest(image.dn)) for row in rows.rows]


def _together(
    heads: Heads, scene: str, replicate: int, table: str, plan: CasePlan
) -> tuple[Observed, list[ReplicateRow]]:
    """Return the common record of a scene's heads, and a row for each estimator of all heads."""
    names = [name for name in plan.estimators if plan.estimator(name).needs == "heads"]
    found = score_together(heads, scene, names, plan, Stopwatch())
    image = digest_of_heads(heads)
    return found, [ReplicateRow.of(row, replicate=replicate, table=table, image=image) for row in found.rows]


def shown(observed: Iterable[Observed | FrozenImage]) -> Shown:
    """Return a method's input from the images of its heads."""
    seen = [one if isinstance(one, FrozenImage) else next(iter(one.images.values())) for one in observed]
    return tuple(
        (digest(image.dn), image.radiance_per_dn if isinstance(image, FrozenImage) else radiance_per_dn(image))
        for image in seen
    )


def digest_of_heads(heads: Heads) -> str:
    """Return the digest of the images of all heads from each digest, in order."""
    digests = [digest(image.dn) for one in heads.values() for image in one.images.values()]
    return hashlib.sha256("\0".join(digests).encode()).hexdigest()


def replay_scene(pack: Pack, scene: str, heads: Mapping[str, str], plan: CasePlan) -> list[ReplicateRow]:
    """Return the rows of all frozen images of a scene, or of its heads, without stratum and bound.

    ``scene``: name for rows of methods that see all heads. ``heads``: scenes in the pack by head, in the camera file's
    order; empty for a camera without heads.
    """
    rows: list[ReplicateRow] = []
    for replicate, images in frozen_together(pack, heads):
        rows += _together(images, scene, replicate, "", plan)[1]
    for case in heads.values() or (scene,):
        frozen = [image for image in pack.images if image.scene == case]
        truth = FrameTruth.from_dict(dict(pack.truths[case]))
        images_of_case = _of_one_frame(frozen_image(truth, image) for image in frozen)
        for image, one in zip(frozen, images_of_case, strict=True):
            rows += _alone(one, case, image.replicate, "", plan)
    return rows


def frozen_image(truth: FrameTruth, frozen: FrozenImage) -> DetectorImage:
    """Return a frozen image as a detector's, with its frozen calibration."""
    known = {} if frozen.radiance_per_dn is None else {"radiance_per_dn": frozen.radiance_per_dn}
    return DetectorImage(frozen.dn, frozen.band, truth, frozen.full_scale, known)


def frozen_heads(pack: Pack, heads: Mapping[str, str]) -> Iterator[dict[str, FrozenImage]]:
    """Yield the frozen images of all heads, for every band and replicate that all of them have."""
    known = {(image.scene, image.band, image.replicate): image for image in pack.images}
    for scene, band, replicate in known if heads else ():
        keys = {head: (case, band, replicate) for head, case in heads.items()}
        if scene == next(iter(heads.values())) and all(key in known for key in keys.values()):
            yield {head: known[key] for head, key in keys.items()}


def frozen_together(pack: Pack, heads: Mapping[str, str]) -> Iterator[tuple[int, dict[str, Observed]]]:
    """Yield the replicate and the images of all heads, as :func:`frozen_heads`."""
    truths = {head: FrameTruth.from_dict(dict(pack.truths[case])) for head, case in heads.items()}
    for frozen in frozen_heads(pack, heads):
        images = {head: frozen_image(truths[head], one) for head, one in frozen.items()}
        replicate = next(iter(frozen.values())).replicate
        yield replicate, {head: Observed({image.band: image}) for head, image in images.items()}


@dataclass(frozen=True)
class Task:
    """One unit: a scene of the suite to render, or one of a baseline to replay (``unit`` None, frozen images in
    ``pack``).

    ``batch``: number of the batch of fresh scenes; None for the suite's scenes. ``known``: see :func:`render_unit`.
    ``heads``: see :func:`replay_scene`.
    """

    name: str
    scene: str
    estimators: tuple[str, ...]
    unit: Unit | None = None
    batch: int | None = None
    replicates: int = 1
    known: frozenset[Shown] = frozenset()
    pack: Path | None = None
    pack_sha256: str = ""
    heads: tuple[tuple[str, str], ...] = ()


class NightWork(Recorded[Task]):
    """Units of a night: a record each, and a file of arrays for a rendered scene."""

    def __init__(self, plan: CasePlan, folder: Path) -> None:
        self.plan = plan
        self.folder: Path | None = folder
        self._place = folder

    def name(self, item: Task) -> str:
        return item.name

    def path(self, item: Task) -> Path:
        return self._place / f"{self.identity(item)}.json"

    def arrays(self, item: Task) -> Path:
        """Return the file of the arrays."""
        return self.path(item).with_suffix(".npz")

    def identity(self, item: Task) -> str:
        """Return the digest of a unit's inputs, the name of its files."""
        content: list[Any] = [item.scene, item.heads, item.pack_sha256, item.replicates, sorted(item.known, key=str)]
        if item.unit is not None:
            content += [unit_identity(item.unit, self.plan), item.unit.cases[0].table]
        content += [self.plan.content(item.estimators), code_digest(__name__, *code_of(item.estimators))]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def finished(self, item: Task) -> Record | None:
        """Return the record of a unit whose arrays are undamaged."""
        return super().finished(item) if item.unit is None or is_intact(self.arrays(item)) else None

    def record(self, item: Task, watch: Stopwatch) -> Record:
        """Run a unit and write its arrays."""
        plan = replace(self.plan, estimators=item.estimators)
        if item.unit is None:
            assert item.pack is not None
            rows = replay_scene(read_pack(item.pack), item.scene, dict(item.heads), plan)
            return {"rows": [row.to_dict() for row in rows]}
        record, arrays = render_unit(item.unit, plan, item.replicates, item.known)
        write_arrays(self.arrays(item), arrays)
        return record


def arrays_of(path: Path, scene: str) -> dict[str, np.ndarray]:
    """Return the arrays of a scene from the file of its unit, which may hold several heads."""
    start = f"{scene}:"
    return {name.removeprefix(start): values for name, values in read_arrays(path).items() if name.startswith(start)}


def sweep(folder: Path, used: Iterable[str]) -> None:
    """Delete the files of units whose identities are not ``used``: of earlier nights and older code."""
    names = frozenset(used)
    for path in folder.iterdir():
        if path.suffix in (".json", ".npz") and path.stem not in names:
            path.unlink(missing_ok=True)
