"""All heads of a scene in a night: what the methods make of them that see every head at once.

Every head is rendered, observed and frozen like a scene of its own: its noise comes from its own identity, as in
``horizonval run``. The images of one replicate are then put together again, in the order of the camera file, for one
row of the scene. Truth and bound of that row are as in a suite: the first head's axes, the information of all heads.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from horizonval.core.outcome import Outcome
from horizonval.frame import DetectorImage, FrameTruth
from horizonval.plugins.supervisor import supervisor_of
from horizonval.scoring.bound import bound_of
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_of_heads, expected_outcome
from horizonval.scoring.row import rounded
from horizonval.sensor.expected_image import radiance_per_dn
from horizonval.sensor.observe import observe as observe_frame
from horizonval.spec.load import Case
from horizonval.studies.regression.baseline.pack import Pack, digest
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.units import (
    Made,
    Observe,
    Record,
    Render,
    Run,
    Seen,
    frozen_image,
    make_scene,
    rows_of_scene,
)
from horizonval.suites.observation import method_radius_m, observation_of_heads
from horizonval.suites.plan import CasePlan


def digest_of_heads(digests: Iterable[str]) -> str:
    """Return the digest of the images of all heads, in their order, from the digest of each."""
    return hashlib.sha256("\0".join(digests).encode()).hexdigest()


def seen_together(images: Sequence[Seen]) -> Seen:
    """Return what a method is shown of all heads at once, from what each head's image shows."""
    return digest_of_heads(sha for sha, _ in images), repr([calibration for _, calibration in images])


def render_heads(
    cases: Sequence[Case],
    plan: CasePlan,
    replicates: int,
    known: Iterable[Seen] = (),
    *,
    estimate: bool = True,
    render: Render | None = None,
    observe: Observe = observe_frame,
    run: Run | None = None,
) -> tuple[Record, dict[str, np.ndarray]]:
    """Return the record of all heads of a scene, and their arrays.

    Parameters
    ----------
    cases : sequence of Case
        One for each head, in the order of the camera file.
    plan, replicates, known, estimate, render, observe, run
        As in :func:`horizonval.studies.regression.units.render_scene`; ``known`` also holds the images of all heads
        together (:func:`seen_together`) that are estimated on anyway.

    Returns
    -------
    record : dict
        ``heads``: the record of each; ``together``: ``{scene, table, heads, bands}``, with the name and the case of
        every head in their order, and by band ``{expected, borderline, bound_arcsec, images}``; ``rows``: of the
        methods that see all heads.
    arrays : dict of ndarray
        Those of each head, ``<case>:`` before their names.
    """
    skipped = frozenset(known)
    options: dict[str, Any] = {"estimate": estimate, "render": render, "observe": observe, "run": run}
    made = {str(case.head): make_scene(case, plan, replicates, skipped, **options) for case in cases}
    first, name = next(iter(made.values())), cases[0].scene_name
    bands: dict[str, Any] = {}
    rows: list[ReplicateRow] = []
    for band in first.images:
        if any(band not in one.images for one in made.values()):
            continue
        about = _about(made, band)
        images = []
        for replicate in range(replicates):
            heads = {head: one.images[band][replicate] for head, one in made.items()}
            seen = seen_together([(digest(image.dn), radiance_per_dn(image)) for image in heads.values()])
            images.append(seen[0])
            if estimate and seen not in skipped:
                due = about["expected"] == Outcome.VALID and not about["borderline"]
                own = {"table": cases[0].table or "", "due": due, "bound_arcsec": about["bound_arcsec"]}
                rows += [replace(row, **own) for row in estimate_together(name, replicate, heads, plan, run)]
        bands[band] = about | {"images": images}
    together = {
        "scene": name,
        "table": cases[0].table or "",
        "heads": [[str(case.head), case.name] for case in cases],
        "bands": bands,
    }
    record = {
        "heads": [one.record for one in made.values()],
        "together": together,
        "rows": [row.to_dict() for row in rows],
    }
    arrays = {
        f"{case.name}:{key}": values
        for case, one in zip(cases, made.values(), strict=True)
        for key, values in one.arrays.items()
    }
    return record, arrays


def _about(made: Mapping[str, Made], band: str) -> dict[str, Any]:
    """Return what a method that sees all heads should report, and what their limbs allow it."""
    truths = [one.frame.truth for one in made.values()]
    expected = expected_of_heads([expected_outcome(truth, band, needs="heads") for truth in truths])
    carried = [found for one in made.values() if (found := one.information[band]) is not None]
    bound = bound_of(reduce(add, carried) if carried else None, truths[0], band).known_arcsec
    return {
        "expected": str(expected.outcome),
        "borderline": expected.borderline,
        "bound_arcsec": None if bound is None else rounded("bound_arcsec", bound),
    }


def replay_heads(pack: Pack, scene: str, heads: Mapping[str, str], plan: CasePlan) -> list[Record]:
    """Return the rows of all frozen images of a scene's heads, alone and together, as plain data without stratum.

    Parameters
    ----------
    pack : Pack
    scene : str
        Under whose name the rows of all heads go.
    heads : mapping of str
        The heads' scenes in the pack by the heads' names, in the order of the camera file.
    plan : CasePlan
    """
    rows = estimate_frozen_heads(pack, scene, heads, plan)
    for case in heads.values():
        rows += rows_of_scene(pack, case, plan)
    return [row.to_dict() for row in rows]


def estimate_frozen_heads(
    pack: Pack, scene: str, heads: Mapping[str, str], plan: CasePlan, *, run: Run | None = None
) -> list[ReplicateRow]:
    """Return the rows of the methods that see all heads; ``run`` in place of them, for experiments with faults."""
    rows = []
    for replicate, images in frozen_together(pack, heads):
        rows += estimate_together(scene, replicate, images, plan, run)
    return rows


def frozen_together(pack: Pack, heads: Mapping[str, str]) -> Iterator[tuple[int, dict[str, DetectorImage]]]:
    """Yield the number of the replicate and the images of all heads, of every band and replicate that all have."""
    known = {(image.scene, image.band, image.replicate): image for image in pack.images}
    truths = {head: FrameTruth.from_dict(dict(pack.truths[case])) for head, case in heads.items()}
    first = next(iter(heads.values()))
    for scene, band, replicate in known:
        keys = {head: (case, band, replicate) for head, case in heads.items()}
        if scene == first and all(key in known for key in keys.values()):
            yield replicate, {head: frozen_image(truths[head], known[key]) for head, key in keys.items()}


def estimate_together(
    scene: str, replicate: int, heads: Mapping[str, DetectorImage], plan: CasePlan, run: Run | None = None
) -> list[ReplicateRow]:
    """Return one row for each method of a plan that sees all heads, without the stratum of its scene."""
    ask = supervisor_of(plan.limits).run if run is None else run
    first = next(iter(heads.values()))
    sha = digest_of_heads(digest(image.dn) for image in heads.values())
    rows = []
    for name in plan.estimators:
        estimator = plan.estimator(name)
        if estimator.needs != "heads":
            continue
        result = ask(name, observation_of_heads(heads, estimator))
        scored = score(first.truth, estimator, result, earth_radius_m=method_radius_m(first.truth))
        about = {"scene": scene, "band": first.band, "replicate": replicate, "estimator": name, "image": sha}
        rows.append(ReplicateRow.of(scored, **about))
    return rows
