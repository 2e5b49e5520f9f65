"""Frames of a run for a viewer that asks for one after the other: a list of all, and each with its exact numbers."""

from __future__ import annotations

import json
import threading
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.report import viewer
from horizonval.report.figures import overlay, picture
from horizonval.report.load import CaseView, ReportRun, load_case, load_run
from horizonval.report.verdict import VERDICTS, verdict_of
from horizonval.scoring.expected import Expected, expected_outcome

KEPT = 16
"""Frames whose answers are kept for whoever steps back and forth."""


MOST_BESIDE, BESIDE_PX = 16, 4_000_000
"""Frames, and their pixels, that a page beside the first one holds."""


class RunFrames:
    """The frames of a run's folder, read when they are asked for, one at a time.

    Parameters
    ----------
    run_dir : Path
        Folder with a ``run.json``.
    """

    def __init__(self, run_dir: Path) -> None:
        self._dir = run_dir
        self._lock = threading.Lock()
        self._kept = lru_cache(KEPT)(self._frame)

    @cached_property
    def estimators(self) -> tuple[str, ...]:
        """The run's estimators, in the suite's order."""
        return load_run(self._dir, 0).estimators

    def listed(self) -> list[dict[str, Any]]:
        """Return every frame of the run, in its order, with outcomes and light but without image.

        Raises
        ------
        UserError
            The run cannot be read.
        """
        with self._lock:
            run = load_run(self._dir, 0)
            return [
                {
                    "name": view.case,
                    "band": view.band,
                    "camera": next((row.camera for row in view.rows.values()), ""),
                    "rows": viewer.rows_of(view, run.estimators),
                    **viewer.light_of(view),
                }
                for view in run.views
            ]

    def frame(self, case: str, band: str) -> dict[str, Any]:
        """Return one frame with everything that the viewer shows, its digital numbers packed without loss.

        Raises
        ------
        UserError
            No such frame, or its image was not kept or is damaged.
        """
        with self._lock:
            return self._kept(case, band)

    def _frame(self, case: str, band: str) -> dict[str, Any]:
        views = [view for view in load_case(self._dir, case) if view.band == band or not band]
        if not views:
            raise UserError(f"no band {band!r}", where=case)
        view = views[0]
        if view.image is None:
            raise UserError(view.problem)
        return one_frame(view, self.estimators)


def striking_frames(run: ReportRun) -> dict[str, Any]:
    """Return what the page beside the first one shows of a run's frames: those that tell most, in the run's order.

    ``frames`` are JSON texts, ``kept`` is how many frames with an image are known, ``viewer_estimators`` whose they
    are. False claims, crashes and refusals of due frames go first, up to a size that keeps the page small.
    """
    views = [view for view in run.views if view.image is not None]
    order = sorted(
        views, key=lambda view: min((VERDICTS.index(verdict_of(row)) for row in view.rows.values()), default=9)
    )
    chosen: set[tuple[str, str]] = set()
    pixels = 0
    for view in order[:MOST_BESIDE]:
        assert view.image is not None
        pixels += view.image.dn.size
        if pixels > BESIDE_PX and chosen:
            break
        chosen.add((view.case, view.band))
    texts = [
        # No text may end the element that it stands in.
        json.dumps(one_frame(view, run.estimators), sort_keys=True).replace("<", "\\u003c")
        for view in views
        if (view.case, view.band) in chosen
    ]
    return {"frames": texts, "kept": len(views), "viewer_estimators": run.estimators}


def one_frame(view: CaseView, estimators: tuple[str, ...], expected: Expected | None = None) -> dict[str, Any]:
    """Return a view that has an image as the viewer takes it: numbers, curves, outcomes and light in one.

    ``expected``: the outcome that the truth lets expect, where that is known already.
    """
    image = view.image
    assert image is not None
    height, width = image.dn.shape
    _, black, white = picture.tone_mapped(image)
    toned = picture.EmbeddedPicture("", black, white)
    return {
        "name": view.case,
        "camera": image.truth.camera_spec.camera.name or "",
        "width": width,
        "height": height,
        "numbers": viewer.packed(image.dn),
        "truth": overlay.horizon_path(image.truth),
        "infrared": overlay.infrared_path(image.truth, view.band),
        "layers": viewer.layers_of(view, image.truth, estimators),
        **viewer.frame_data(view, expected or expected_outcome(image.truth, view.band), toned, estimators),
    }
