"""The work of a night in units that run anywhere: render a scene again, estimate on images, one fresh scene.

Each is a function of plain data and files; it returns plain data, and leaves arrays in a file of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit, Observation
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.plugins.supervisor import supervisor_of
from horizonval.scoring.bound import bound_of
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.information import LimbInformation, information_of
from horizonval.scoring.row import rounded
from horizonval.sensor.expected_image import radiance_per_dn
from horizonval.sensor.observe import observe as observe_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import Case
from horizonval.studies.regression.baseline.pack import FrozenImage, Pack, digest, read_pack
from horizonval.studies.regression.regions import noise_in_space, regions_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.suites.observation import method_radius_m, observation_of
from horizonval.suites.plan import CasePlan
from horizonval.suites.record import camera_name

Record = dict[str, Any]
Run = Callable[[str, Observation], Fit | Refusal]
Render = Callable[[Any, CameraSpec], RadianceFrame]
Observe = Callable[..., DetectorImage]
Seen = tuple[str, float | str | None]
"""What an estimator is shown of an image: its digest, and the band radiance of a digital number, None if not known; of
the images of all heads at once, those of each as a text."""


@dataclass(frozen=True)
class Made:
    """A scene rendered and observed: what the night keeps of it, and what methods that see all heads need beside.

    ``images`` are by band, one for every replicate; ``information`` is that of the limb, by band.
    """

    record: Record
    arrays: dict[str, np.ndarray]
    frame: RadianceFrame
    images: dict[str, list[DetectorImage]]
    information: dict[str, LimbInformation | None]


def render_scene(
    case: Case,
    plan: CasePlan,
    replicates: int,
    known: Iterable[Seen] = (),
    *,
    estimate: bool = True,
    render: Render | None = None,
    observe: Observe = observe_frame,
    run: Run | None = None,
) -> tuple[Record, dict[str, np.ndarray]]:
    """Return the record of a scene rendered, observed with every noise seed, and estimated; and its arrays.

    Parameters
    ----------
    case : Case
        The suite's table that it comes from is its stratum.
    plan : CasePlan
        Estimators and what they may use; those that see all heads are left out here.
    replicates : int
    known : iterable of (str, float or None)
        Images, each with its calibration, on which the estimators are run anyway; they are left out here.
    estimate : bool
    render, observe, run : callable, optional
        In place of the package's own, for experiments with faults.

    Returns
    -------
    record : dict
        ``scene``, ``table``, ``camera``, ``truth`` (plain), ``bands``: by name ``{radiance_sha256, expected,
        borderline, bound_arcsec, full_scale, images, radiance_per_dn, noise_dn}``, and ``rows``
        (:class:`ReplicateRow`, plain).
    arrays : dict of ndarray
        ``radiance.<band>`` (float32), ``regions``, ``dn.<band>.<seed>``.
    """
    made = make_scene(
        case, plan, replicates, frozenset(known), estimate=estimate, render=render, observe=observe, run=run
    )
    return made.record, made.arrays


def make_scene(
    case: Case,
    plan: CasePlan,
    replicates: int,
    known: frozenset[Seen],
    *,
    estimate: bool,
    render: Render | None,
    observe: Observe,
    run: Run | None,
) -> Made:
    """Render and observe a scene, and estimate on it: see :func:`render_scene`."""
    frame = (render or _renderer())(case.scene, case.camera)
    regions = regions_of(frame.maps["hit"], frame.maps["tangent_height"])
    arrays: dict[str, np.ndarray] = {"regions": regions}
    bands: dict[str, Any] = {}
    rows: list[ReplicateRow] = []
    observed: dict[str, list[DetectorImage]] = {}
    information: dict[str, LimbInformation | None] = {}
    for band in (one.name for one in case.camera.band):
        expected = expected_outcome(frame.truth, band)
        due = expected.outcome == Outcome.VALID and not expected.borderline
        information[band] = information_of(frame, case.camera, band)
        bound = bound_of(information[band], frame.truth, band).known_arcsec
        about: dict[str, Any] = {"table": case.table or "", "due": due}
        about["bound_arcsec"] = None if bound is None else rounded("bound_arcsec", bound)
        clean = observe(frame, case.camera, band=band, seed=0, noise=False).dn
        arrays[f"radiance.{band}"] = frame.radiance[band]
        images, calibrations, noise, full_scale = [], [], [], 0
        observed[band] = []
        for seed in range(replicates):
            image = observe(frame, case.camera, band=band, seed=seed)
            observed[band].append(image)
            sha, full_scale = digest(image.dn), image.full_scale
            calibration = radiance_per_dn(image)
            images.append(sha)
            calibrations.append(calibration)
            arrays[f"dn.{band}.{seed}"] = image.dn
            noise.append(noise_in_space(image.dn, clean, regions))
            if estimate and (sha, calibration) not in known:
                found = estimate_image(case.name, seed, image, plan, run)
                rows += [replace(row, **about) for row in found]
        known_noise = [value for value in noise if value is not None]
        bands[band] = {
            "radiance_sha256": digest(frame.radiance[band]),
            "expected": str(expected.outcome),
            "borderline": expected.borderline,
            "bound_arcsec": about["bound_arcsec"],
            "full_scale": full_scale,
            "images": images,
            "radiance_per_dn": calibrations,
            "noise_dn": math.sqrt(float(np.mean(np.square(known_noise)))) if known_noise else None,
        }
    record = {
        "scene": case.name,
        "table": case.table or "",
        "camera": camera_name(case),
        "truth": plain_truth(frame.truth),
        "bands": bands,
        "rows": [row.to_dict() for row in rows],
    }
    return Made(record, arrays, frame, observed, information)


def _renderer() -> Render:
    from horizonval.renderer.scene.frame import render_frame

    return render_frame


def plain_truth(truth: FrameTruth) -> dict[str, Any]:
    """Return a truth as plain data without the infrared horizon: scoring again does not need it."""
    return replace(truth, infrared_horizon={}).to_dict()


def replay_scene(pack: Path, scene: str, plan: CasePlan) -> list[Record]:
    """Return the rows of all frozen images of a scene, as plain data and without its stratum."""
    return [row.to_dict() for row in rows_of_scene(read_pack(pack), scene, plan)]


def rows_of_scene(pack: Pack, scene: str, plan: CasePlan) -> list[ReplicateRow]:
    """Return the rows of all frozen images of a scene, without its stratum."""
    truth = FrameTruth.from_dict(dict(pack.truths[scene]))
    return estimate_frozen(truth, scene, (image for image in pack.images if image.scene == scene), plan)


def estimate_frozen(
    truth: FrameTruth, scene: str, images: Iterable[FrozenImage], plan: CasePlan, *, run: Run | None = None
) -> list[ReplicateRow]:
    """Return the rows of some frozen images; ``run`` in place of the estimators, for experiments with faults."""
    rows: list[ReplicateRow] = []
    for frozen in images:
        rows += estimate_image(scene, frozen.replicate, frozen_image(truth, frozen), plan, run)
    return rows


def frozen_image(truth: FrameTruth, frozen: FrozenImage) -> DetectorImage:
    """Return a frozen image as a detector's, with the calibration that it was frozen with."""
    known = {} if frozen.radiance_per_dn is None else {"radiance_per_dn": frozen.radiance_per_dn}
    return DetectorImage(frozen.dn, frozen.band, truth, frozen.full_scale, known)


def estimate_image(
    scene: str, replicate: int, image: DetectorImage, plan: CasePlan, run: Run | None = None
) -> list[ReplicateRow]:
    """Return one row for each estimator that sees one image, without the stratum of its scene."""
    ask = supervisor_of(plan.limits).run if run is None else run
    sha = digest(image.dn)
    rows = []
    for name in plan.estimators:
        estimator = plan.estimator(name)
        if estimator.needs == "heads":
            continue
        result = ask(name, observation_of(image, estimator))
        scored = score(image.truth, estimator, result, earth_radius_m=method_radius_m(image.truth))
        about = {"scene": scene, "band": image.band, "replicate": replicate, "estimator": name, "image": sha}
        rows.append(ReplicateRow.of(scored, **about))
    return rows


def is_due(expected: Mapping[str, Any]) -> bool:
    """Whether a frame clearly should give an attitude."""
    return expected["expected"] == Outcome.VALID and not expected["borderline"]
