"""What the page of a night shows of its images: one of each scene and band, with tonight's outcomes and claims.

A night keeps what methods claim as roll and pitch, and no limb points. The limb of a claim is therefore drawn as the
true horizon would lie at the claimed attitude.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.frame import FrameTruth
from horizonval.geometry import frames
from horizonval.geometry.horizon import horizon_cam
from horizonval.report import viewer
from horizonval.report.load import CaseView
from horizonval.report.words import VERDICTS, Record, opening, verdict_of
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.row import Row
from horizonval.studies.regression.baseline.baseline import Baseline
from horizonval.studies.regression.baseline.pack import FrozenImage
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.tonight.gathered import Gathered
from horizonval.studies.regression.units import frozen_image

MOST_SHOWN, MOST_PX = 64, 2_000_000
"""Images, and their pixels, that the page of a night holds."""
_ARCSEC = math.radians(1 / 3600)
_SAMPLES = 7200
Key = tuple[str, str, int]
"""Scene, band, replicate."""


def of_night(night: Gathered) -> dict[str, Any]:
    """Return what the page of a night opens with: :func:`shown_of` tonight's images, else of the frozen ones."""
    if not night.scenes:
        return of_baseline(night.accepted, night.replayed) if night.accepted is not None else shown_of([], {}, _nothing)

    def load(key: Key) -> FrozenImage:
        scene, band, replicate = key
        about = night.scenes[scene]["bands"][band]
        with files.open_file(night.arrays[scene]) as stream, np.load(stream, allow_pickle=False) as arrays:
            name = f"dn.{band}.{replicate}"
            dn = arrays[name] if name in arrays else arrays[f"{scene}:{name}"]
        return FrozenImage(scene, band, replicate, about["full_scale"], dn, about["radiance_per_dn"][replicate])

    truths = {scene: record["truth"] for scene, record in night.scenes.items()}
    return shown_of(night.all_rows(), truths, load)


def of_baseline(accepted: Baseline, rows: Sequence[ReplicateRow]) -> dict[str, Any]:
    """Return the same of rows on the frozen images of a baseline."""
    images = {(image.scene, image.band, image.replicate): image for image in accepted.images.images}
    return shown_of([row for row in rows if row.scene not in accepted.together], accepted.images.truths, images.get)


def shown_of(
    rows: Sequence[ReplicateRow],
    truths: Mapping[str, Mapping[str, Any]],
    load: Callable[[Key], FrozenImage | None],
) -> dict[str, Any]:
    """Return what a page shows of some rows.

    Parameters
    ----------
    rows : sequence of ReplicateRow
    truths : mapping
        By scene, plain.
    load : callable
        Returns an image of a scene, band and replicate; ``None`` where it is not there.

    Returns
    -------
    dict
        ``sentences``, one for each method or of many the best and the worst; ``frames``, as the viewer takes them;
        ``kept``, of how many scenes and bands; ``estimators``.
    """
    estimators = tuple(dict.fromkeys(row.estimator for row in rows))
    known = {scene: FrameTruth.from_dict(dict(truths[scene])) for scene in {row.scene for row in rows} & set(truths)}
    by_image: dict[Key, list[ReplicateRow]] = {}
    for row in rows:
        if row.scene in known:
            by_image.setdefault((row.scene, row.band, row.replicate), []).append(row)
    expected = {place: expected_outcome(known[place[0]], place[1]) for place in {key[:2] for key in by_image}}

    def plain(row: ReplicateRow) -> Row:
        about, truth = expected[row.scene, row.band], known[row.scene]
        return Row(
            case=row.scene,
            camera=truth.camera_spec.camera.name or "",
            band=row.band,
            estimator=row.estimator,
            expected=str(about.outcome),
            borderline=about.borderline,
            status=row.status,
            reason=row.reason,
            false_valid=row.false_valid,
            nadir_error_arcsec=row.nadir_error_arcsec,
            bound_arcsec=row.bound_arcsec,
            error_over_bound=row.error_over_bound,
        )

    by_method = {key: {row.estimator: plain(row) for row in own} for key, own in by_image.items()}
    rank = {key: min(VERDICTS.index(verdict_of(row)) for row in own.values()) for key, own in by_method.items()}
    # Of the replicates of a scene the worst, and of those alike the first.
    worst: dict[tuple[str, str], Key] = {}
    for key in sorted(by_method, key=lambda key: (rank[key], key[2])):
        worst.setdefault(key[:2], key)
    chosen: dict[Key, FrozenImage] = {}
    pixels = 0
    for key in sorted(worst.values(), key=lambda key: rank[key])[:MOST_SHOWN]:
        if (image := load(key)) is None:
            continue
        pixels += image.dn.size
        if pixels > MOST_PX and chosen:
            break
        chosen[key] = image
    shown = []
    for key in (key for key in worst_in_order(by_image, worst) if key in chosen):
        truth = known[key[0]]
        view = CaseView(key[0], key[1], by_method[key], {}, frozen_image(truth, chosen[key]), "", False, "")
        found = viewer.one_frame(view, estimators, expected[key[:2]]) | {"name": f"{key[0]}, seed {key[2]}"}
        horizon = horizon_cam(truth.r_itrs, truth.q_cam_from_itrs, truth.apparent_ellipsoid, _SAMPLES)
        found["layers"] = [_layer(truth, horizon, by_image[key], name) for name in estimators]
        shown.append(found)
    return {
        "sentences": opening([_record(name, rows) for name in estimators]),
        "frames": shown,
        "kept": len(worst),
        "estimators": estimators,
    }


def worst_in_order(images: Iterable[Key], worst: Mapping[tuple[str, str], Key]) -> list[Key]:
    """Return the chosen replicates in the order in which their scenes and bands come first."""
    return [worst[place] for place in dict.fromkeys(key[:2] for key in images)]


def _nothing(_key: Key) -> None:
    return None


def _layer(truth: FrameTruth, horizon: FloatArray, rows: Sequence[ReplicateRow], estimator: str) -> dict[str, str]:
    """Return the limb of a claim as path data: the true horizon as it would lie at the claimed attitude."""
    row = next((one for one in rows if one.estimator == estimator), None)
    if row is None or row.roll_error_arcsec is None or row.pitch_error_arcsec is None:
        return {"points": "", "limb": ""}
    true = np.asarray(truth.nadir_geocentric_cam)
    roll, pitch = frames.roll_pitch_of_nadir(frames.rotate(frames.inverse(truth.q_cam_from_body), true))
    claimed = frames.rotate(
        truth.q_cam_from_body,
        frames.nadir_of_roll_pitch(roll + row.roll_error_arcsec * _ARCSEC, pitch + row.pitch_error_arcsec * _ARCSEC),
    )
    turned = frames.rotate(_shortest_turn(true, claimed), np.concatenate([horizon, horizon[:1]]))
    return {"points": "", "limb": viewer.visible_path(truth.camera_model, turned)}


def _shortest_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the quaternion, scalar last, that turns one unit vector into another not opposite to it."""
    q = np.append(np.cross(a, b), 1.0 + np.dot(a, b))
    turn: FloatArray = q / np.linalg.norm(q)
    return turn


def _record(name: str, rows: Sequence[ReplicateRow]) -> Record:
    own = [row for row in rows if row.estimator == name]
    due = [row for row in own if row.due]
    return Record(
        name=name,
        due=len(due),
        right=sum(row.is_claim and not row.false_valid for row in due),
        errors=tuple(row.nadir_error_arcsec for row in own if row.is_claim and row.nadir_error_arcsec is not None),
        false=_places(row for row in own if row.false_valid or row.status == Outcome.CRASHED),
        silent=_places(row for row in due if not row.is_claim and row.status != Outcome.CRASHED),
    )


def _places(rows: Iterable[ReplicateRow]) -> tuple[tuple[str, int], ...]:
    """Return in which tables of the suite some rows are, and how many; the most first."""
    found: dict[str, int] = {}
    for row in rows:
        place = f'in "{row.table or row.scene}"'
        found[place] = found.get(place, 0) + 1
    return tuple(sorted(found.items(), key=lambda item: (-item[1], item[0])))
