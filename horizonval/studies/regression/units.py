"""The work of a night in units that run anywhere: render a scene again, estimate on images, one fresh scene.

Each is a function of plain data and files; it returns plain data, and leaves arrays in a file of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.process.sandbox import sandbox_of
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.scoring.bound import bound_of
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.information.of_frame import information_of
from horizonval.scoring.row import rounded
from horizonval.sensor.calibrated import radiance_per_dn
from horizonval.sensor.observe import observe as observe_frame
from horizonval.spec.load import Case
from horizonval.spec.sensor.camera import CameraSpec
from horizonval.studies.regression.baseline.pack import FrozenImage, digest, read_pack
from horizonval.studies.regression.regions import noise_in_space, regions_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.suites.observation import method_radius_m, observation_of
from horizonval.suites.plan import CasePlan
from horizonval.suites.record import camera_name

Record = dict[str, Any]
Run = Callable[[str, Observation], Fit | Refusal]
Render = Callable[[Any, CameraSpec], RadianceFrame]
Observe = Callable[..., DetectorImage]
Seen = tuple[str, float | None]
"""What an estimator is shown of an image: its digest, and the band radiance of a digital number, None if not known."""


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
        Estimators and what they may use.
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
    frame = (render or _renderer())(case.scene, case.camera)
    regions = regions_of(frame.maps["hit"], frame.maps["tangent_height"])
    arrays: dict[str, np.ndarray] = {"regions": regions}
    bands: dict[str, Any] = {}
    rows: list[ReplicateRow] = []
    skipped = frozenset(known)
    for band in (one.name for one in case.camera.band):
        expected = expected_outcome(frame.truth, band)
        due = expected.outcome == Outcome.VALID and not expected.borderline
        bound = bound_of(information_of(frame, case.camera, band), frame.truth, band).known_arcsec
        about: dict[str, Any] = {"table": case.table or "", "due": due}
        about["bound_arcsec"] = None if bound is None else rounded("bound_arcsec", bound)
        clean = observe(frame, case.camera, band=band, seed=0, noise=False).dn
        arrays[f"radiance.{band}"] = frame.radiance[band]
        images, calibrations, noise, full_scale = [], [], [], 0
        for seed in range(replicates):
            image = observe(frame, case.camera, band=band, seed=seed)
            sha, full_scale = digest(image.dn), image.full_scale
            calibration = radiance_per_dn(image)
            images.append(sha)
            calibrations.append(calibration)
            arrays[f"dn.{band}.{seed}"] = image.dn
            noise.append(noise_in_space(image.dn, clean, regions))
            if estimate and (sha, calibration) not in skipped:
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
    return record, arrays


def _renderer() -> Render:
    from horizonval.renderer.scene.frame import render_frame

    return render_frame


def plain_truth(truth: FrameTruth) -> dict[str, Any]:
    """Return a truth as plain data without the infrared horizon: scoring again does not need it."""
    return replace(truth, infrared_horizon={}).to_dict()


def replay_scene(pack: Path, scene: str, plan: CasePlan) -> list[Record]:
    """Return the rows of all frozen images of a scene, as plain data and without its stratum."""
    content = read_pack(pack)
    truth = FrameTruth.from_dict(dict(content.truths[scene]))
    images = (image for image in content.images if image.scene == scene)
    return [row.to_dict() for row in estimate_frozen(truth, scene, images, plan)]


def estimate_frozen(
    truth: FrameTruth, scene: str, images: Iterable[FrozenImage], plan: CasePlan, *, run: Run | None = None
) -> list[ReplicateRow]:
    """Return the rows of some frozen images; ``run`` in place of the estimators, for experiments with faults."""
    rows: list[ReplicateRow] = []
    for frozen in images:
        known = {} if frozen.radiance_per_dn is None else {"radiance_per_dn": frozen.radiance_per_dn}
        image = DetectorImage(frozen.dn, frozen.band, truth, frozen.full_scale, known)
        rows += estimate_image(scene, frozen.replicate, image, plan, run)
    return rows


def estimate_image(
    scene: str, replicate: int, image: DetectorImage, plan: CasePlan, run: Run | None = None
) -> list[ReplicateRow]:
    """Return one row for each estimator, without the stratum of its scene."""
    ask = sandbox_of(plan.limits).run if run is None else run
    sha = digest(image.dn)
    rows = []
    for name in plan.estimators:
        estimator = plan.estimator(name)
        result = ask(name, observation_of(image, estimator))
        scored = score(image.truth, estimator, result, earth_radius_m=method_radius_m(image.truth))
        about = {"scene": scene, "band": image.band, "replicate": replicate, "estimator": name, "image": sha}
        rows.append(ReplicateRow.of(scored, **about))
    return rows


def is_due(expected: Mapping[str, Any]) -> bool:
    """Whether a frame clearly should give an attitude."""
    return expected["expected"] == Outcome.VALID and not expected["borderline"]
