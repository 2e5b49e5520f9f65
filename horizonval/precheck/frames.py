"""Look at the frames of a group, all of them or an even sample, and add up what they cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from horizonval.core.errors import UserError
from horizonval.earth.optical import node_counts, optical_model
from horizonval.precheck.cost import RECORD_BYTES, Cost, FrameCost, column_key, frame_cost, json_of_bands
from horizonval.precheck.findings import Finding, Level
from horizonval.precheck.limb import LimbView, Needs, limb_views
from horizonval.renderer.scene.shared_view import shared_view
from horizonval.spec.load import Case
from horizonval.spec.suite import Keep
from horizonval.truth.frame_truth import truth_of


@dataclass(frozen=True)
class Group:
    """Frames that are judged together: a suite's camera, a study's design.

    Attributes
    ----------
    subject : str
    cases : tuple of Case
    estimators : int
        How many run on each image.
    needs : {"image", "pose", "heads"}
    most : int or None
        Look at no more of them.
    """

    subject: str
    cases: tuple[Case, ...]
    estimators: int = 1
    needs: Needs = "image"
    most: int | None = None

    @property
    def count(self) -> int:
        """Frames to be looked at if there is time."""
        return len(self.cases) if self.most is None else min(len(self.cases), self.most)


@dataclass
class Look:
    """What was seen of a group.

    Attributes
    ----------
    views : dict
        By band, one of every frame that was looked at.
    costs : list of FrameCost
        Of the same frames.
    errors : list of Finding
        Frames that cannot be made.
    examined : int
    """

    views: dict[str, list[LimbView]] = field(default_factory=dict)
    costs: list[FrameCost] = field(default_factory=list)
    errors: list[Finding] = field(default_factory=list)
    examined: int = 0


def sample_sizes(counts: Sequence[int], most: int) -> list[int]:
    """Return how many frames of every group to look at: all, or an even share of ``most``, at least one of a group.

    What a small group leaves of its share goes to the others. Of more groups than ``most`` the rest get none.
    """
    sizes = [0] * len(counts)
    left = most
    order = sorted(range(len(counts)), key=lambda i: counts[i])
    for position, i in enumerate(order):
        sizes[i] = min(counts[i], max(left // (len(order) - position), 1 if left > 0 else 0))
        left -= sizes[i]
    return sizes


def spread(cases: Sequence[Case], count: int) -> list[Case]:
    """Return an even sample of cases in their order, the first among them."""
    if count >= len(cases):
        return list(cases)
    places = np.floor(np.arange(count) * len(cases) / max(count, 1)).astype(int)
    return [cases[int(i)] for i in places]


class Watcher:
    """Looks at frames; what several of them share is worked out once."""

    def __init__(self) -> None:
        self._spectral: dict[tuple[str, ...], dict[str, int]] = {}

    def look(self, group: Group, count: int, *, infrared: bool, cost: bool = True) -> Look:
        """Look at a sample of a group.

        Parameters
        ----------
        group : Group
        count : int
            Frames of the sample.
        infrared : bool
            Whether to work out the infrared horizon of its first frame, hence the level of thermal limbs there: up to
            2 s for every thermal band.
        cost : bool
            Whether to work out what the frames cost, and with it whether their air and bands are known.
        """
        seen = Look()
        for number, case in enumerate(spread(group.cases, count)):
            seen.examined += 1
            try:
                spectral = self.spectral(case) if cost else None
                truth = truth_of(case.scene, case.camera, infrared=infrared and number == 0)
            except UserError as e:
                seen.errors.append(cannot_run(e, group.subject))
                continue
            for view in limb_views(case.name, truth, case.camera, group.needs):
                seen.views.setdefault(view.band, []).append(view)
            if spectral is not None:
                seen.costs.append(frame_cost(truth, case.scene, case.camera, spectral, group.estimators))
        return seen

    def spectral(self, case: Case) -> dict[str, int]:
        """Return the spectral nodes of a frame's bands, worked out once for equal air, ground and bands.

        Raises
        ------
        UserError
            As :func:`horizonval.earth.optical.optical_model`: a band outside the tables, air that is unknown.
        """
        scene = case.scene
        air, surface = scene.atmosphere.model_dump_json(), scene.surface.model_dump_json()
        key = (air, surface, json_of_bands(case.camera), str(scene.render.band_error))
        if key not in self._spectral:
            self._spectral[key] = node_counts(optical_model(scene, case.camera))
        return self._spectral[key]


def cannot_run(error: UserError, subject: str = "") -> Finding:
    """Return an error of the user's as a finding."""
    what = f"{error.where}: {error.what}" if error.where else error.what
    fix = "; ".join(part for part in (f"expected {error.expected}" if error.expected else "", error.fix) if part)
    return Finding(Level.ERROR, "cannot-run", what, fix=fix, subject=subject)


def total_cost(groups: Sequence[Group], looks: Sequence[Look], keep: Keep, draws: int = 1) -> Cost | None:
    """Return the cost of all frames of groups from that of those that were looked at; None if none can be made.

    Frames that are not looked at are taken to cost the mean of those of their group that are, those of groups without
    any the mean of all.
    """
    known = [cost for look in looks for cost in look.costs]
    if not known:
        return None
    totals: Mapping[str, float] = dict.fromkeys(("cells", "evaluations", "render_s", "observe_s", "estimate_s"), 0.0)
    totals = dict(totals)
    disk, frames = 0.0, 0
    columns: dict[tuple[object, ...], FrameCost] = {}
    for group, look in zip(groups, looks, strict=True):
        costs, n = look.costs or known, len(group.cases)
        for key in totals:
            totals[key] += n * float(np.mean([getattr(cost, key) for cost in costs]))
        places = {shared_view(case.scene, case.camera) for case in group.cases}
        totals["render_s"] += len(places) * float(np.mean([cost.view_tables_s for cost in costs]))
        frame_bytes, image_bytes = (
            float(np.mean([getattr(c, k) for c in costs])) for k in ("frame_bytes", "image_bytes")
        )
        disk += n * RECORD_BYTES + (0.0 if keep == "none" else n * (frame_bytes + image_bytes))
        frames += n
        # Columns of a group differ in what they hold, hardly in how many nodes they have.
        columns |= {column_key(case.scene, case.camera): costs[0] for case in group.cases if costs[0].tables}
    totals["observe_s"] *= draws
    totals["estimate_s"] *= draws
    return Cost(
        frames=frames,
        **totals,
        tables=sum(cost.tables for cost in columns.values()),
        tables_s=sum(cost.tables_s for cost in columns.values()),
        memory_mb=max(cost.memory_mb for cost in known),
        disk_mb=disk / 1e6,
    )
