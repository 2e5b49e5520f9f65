"""Read the folder of a run, finished or not."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.errors import DamagedFileError, UserError, misfit
from horizonval.frame import DetectorImage
from horizonval.scoring.row import Row
from horizonval.store.folder import RunFolder, read_json
from horizonval.store.named import archive_of
from horizonval.store.store import Store


@dataclass(frozen=True)
class CaseView:
    """One band of one case: a tile of the report.

    ``image``: None if missing, with the reason in ``problem``. ``broken``: the frame itself failed. ``shown``: a long
    report shows this case; other images and details are not read. A view of all heads of a scene shows the first one's
    image; ``head_paths``: of every head, or empty.
    """

    case: str
    band: str
    rows: dict[str, Row]
    details: dict[str, dict[str, Any]]
    image: DetectorImage | None
    problem: str
    broken: bool
    image_path: str
    shown: bool = True
    scene: str = ""
    head_paths: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReportRun:
    """A run as the report needs it: views in the suite's order, failed cases, requested figures.

    ``figures``: from :func:`horizonval.suites.record.figure_plans`. ``study``: whether it is a trade study.
    ``command``: words that repeat the run in its folder. ``programs``: estimators that are programs of the suite's
    file. ``given_pose``: estimators that receive the true pose. ``likelihood``: estimators with claims of a likelihood
    fit. ``orbit``: cases that sample an orbit. ``prior``: the table ``[prior]`` of all frames.
    """

    suite: str
    title: str
    version: str
    estimators: tuple[str, ...]
    cases: tuple[str, ...]
    missing: tuple[str, ...]
    views: tuple[CaseView, ...]
    figures: tuple[dict[str, Any], ...] = ()
    study: bool = False
    command: tuple[str, ...] = ()
    programs: tuple[str, ...] = ()
    given_pose: tuple[str, ...] = ()
    likelihood: tuple[str, ...] = ()
    orbit: frozenset[str] = frozenset()
    prior: dict[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> list[Row]:
        """Every row, in the order of the views."""
        return [row for view in self.views for row in view.rows.values()]

    @property
    def again(self) -> str:
        """The command that repeats the run, quoted for a shell."""
        return shlex.join(self.command)

    @property
    def suite_of_programs(self) -> dict[str, str]:
        """The suite's file, relative to the run's folder, by program estimator."""
        return dict.fromkeys(self.programs, self.command[2]) if len(self.command) > 2 else {}

    @property
    def judged_rows(self) -> list[Row]:
        """The rows of estimators that do not receive the true pose."""
        return [row for row in self.rows if row.estimator not in self.given_pose]

    @property
    def judged_estimators(self) -> tuple[str, ...]:
        """The estimators that do not receive the true pose."""
        return tuple(name for name in self.estimators if name not in self.given_pose)


def load_run(run_dir: Path, most: int | None = None) -> ReportRun:
    """Read ``run.json``, the case files and the detector images.

    Missing cases and missing or damaged images are part of the report. Images of at most ``most`` cases are read: up to
    half of them failures and unexpected outcomes, the rest evenly spread over the others. Raises ``UserError``: no
    ``run.json``. Raises ``DamagedFileError``: ``run.json`` or a case file was changed.
    """
    path = run_dir / "run.json"
    if not path.is_file():
        raise UserError("no run.json", where=str(run_dir), expected="the folder of a run")
    head = _read(path, ("suite", "estimators", "cases"))
    shown = _shown(run_dir, head["cases"], most)
    store = _store(run_dir, head)
    scenes = _scenes_by_first_head(run_dir, head)
    shown |= {first for first, scene in scenes.items() if scene in shown}
    names = [name for name in head["cases"] if name not in scenes.values()]
    views = {name: _views_of(run_dir, head, store, name, name in shown, scenes.get(name)) for name in names}
    for view in (view for found in views.values() for view in found or ()):
        if other := [name for name in view.rows if name not in head["estimators"]]:
            what = f"does not name the estimator {other[0]!r} of the case {view.case!r}"
            raise DamagedFileError(what, where=str(path), fix="run the suite again")
    return ReportRun(
        suite=head["suite"],
        title=head.get("title") or "",
        version=head.get("version") or "",
        estimators=tuple(head["estimators"]),
        cases=tuple(head["cases"]),
        missing=tuple(name for name, found in views.items() if found is None),
        views=tuple(view for found in views.values() for view in found or ()),
        figures=tuple(head.get("figures") or ()),
        study=bool(head.get("study")),
        command=tuple(head.get("command") or ()),
        programs=tuple(head.get("programs") or ()),
        given_pose=tuple(head.get("given_pose") or ()),
        likelihood=tuple(head.get("likelihood") or ()),
        orbit=frozenset(head.get("orbit") or ()),
        prior=head.get("prior") or {},
    )


def load_case(run_dir: Path, case: str) -> list[CaseView]:
    """Return the views of one case of a run with their images.

    Raises ``UserError``: no run or no finished case of that name. Raises ``DamagedFileError``: a changed file.
    """
    head = _read(RunFolder(run_dir).suite, ("suite", "estimators", "cases"))
    scene = _scenes_by_first_head(run_dir, head).get(case)
    views = _views_of(run_dir, head, _store(run_dir, head), case, True, scene) if case in head["cases"] else None
    if views is None:
        raise UserError(f"no finished case {case!r}", where=str(run_dir))
    return views


def _read(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    data = read_json(path, fix="run the suite again") or {}
    absent = [key for key in keys if key not in data]
    if absent:
        raise DamagedFileError(f"no key {absent[0]!r}", where=str(path), fix="run the suite again")
    result: dict[str, Any] = data
    return result


def _shown(run_dir: Path, names: list[str], most: int | None) -> set[str]:
    if most is None or len(names) <= most:
        return set(names)
    if most == 0:
        return set()
    striking = [name for name in names if _is_striking(RunFolder(run_dir).case(name))]
    first = _spread(striking, most // 2)
    return {*first, *_spread([name for name in names if name not in set(striking)], most - len(first))}


def _spread(names: list[str], most: int) -> list[str]:
    """Return at most so many names, evenly spread."""
    return names if len(names) <= most else [names[i * len(names) // most] for i in range(most)]


def _is_striking(path: Path) -> bool:
    """Whether a case failed or has a false or unexpected outcome."""
    if not path.is_file():
        return False
    record = _read(path, ("rows",))
    return bool(record.get("error")) or any(Row.from_dict(row).is_failure for row in record["rows"])


def _store(run_dir: Path, head: dict[str, Any]) -> Store:
    # Rescored runs have their images elsewhere.
    return Store(archive_of(RunFolder(run_dir), head), read_only=True)


def _scenes_by_first_head(run_dir: Path, head: dict[str, Any]) -> dict[str, str]:
    """Return cases of all heads together by the case of their first head, where both are finished and did not fail."""

    def is_whole(case: str) -> bool:
        path = RunFolder(run_dir).case(case)
        return path.is_file() and not _read(path, ()).get("error")

    found = {heads[0][1]: scene for scene, heads in (head.get("heads") or {}).items() if heads}
    return {first: scene for first, scene in found.items() if is_whole(first) and is_whole(scene)}


def _views_of(
    run_dir: Path, head: dict[str, Any], store: Store, case: str, shown: bool, scene: str | None = None
) -> list[CaseView] | None:
    """Return the views of a case, with shown images; None if it is not finished.

    ``scene``: case whose results of all heads together are added to those of this head.
    """
    folder = RunFolder(run_dir)
    path = folder.case(case)
    if not path.is_file():
        return None
    record = _read(path, ("case", "rows", "details"))
    if record["case"] != case:
        raise DamagedFileError(f"holds the results of {record['case']!r}", where=str(path), fix="run the suite again")
    try:
        heads = {}
        if scene is not None:
            together = _read(folder.case(scene), ("rows", "details"))
            record = {
                **record,
                "rows": [*record["rows"], *together["rows"]],
                "details": {**record["details"], **together["details"]},
            }
            for name, case_of_head in head["heads"][scene] if shown else ():
                its = folder.case(case_of_head)
                heads[name] = dict(_read(its, ()).get("images") or {}) if its.is_file() else {}
        return [replace(view, scene=scene or "") for view in _views(record, store, run_dir, shown, heads)]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise DamagedFileError(
            f"not a case's results: {misfit(error)}", where=str(path), fix="run the suite again"
        ) from error


def _views(
    record: dict[str, Any], store: Store, run_dir: Path, shown: bool, heads: dict[str, dict[str, str]]
) -> list[CaseView]:
    images: dict[str, str] = dict(record.get("images") or {})
    if not images and record.get("image"):
        images = {"": record["image"]}
    rows = [Row.from_dict(row) for row in record["rows"]]
    # A failed frame has rows but no images; a frame without estimators has images but no rows.
    bands = list(dict.fromkeys([*(band for band in images if band), *(row.band for row in rows)])) or [""]
    views = []
    for i, band in enumerate(bands):
        address = images.get(band) or (images.get("") if i == 0 else None)
        image, problem = _image(store, address, record.get("error")) if shown else (None, "")
        names = {row.estimator for row in rows} | set(record["details"])
        details = {
            name: found
            for name in sorted(names)
            if shown and (found := record["details"].get(name if i == 0 else f"{name} [{band}]")) is not None
        }
        for found in details.values():
            np.asarray(found.get("points") or [], dtype=np.float64).reshape(-1, 2)
            np.asarray((found.get("fit") or {}).get("nadir_cam") or [], dtype=np.float64)
        views.append(
            CaseView(
                case=record["case"],
                band=band or (image.band if image else ""),
                rows={row.estimator: row for row in rows if row.band == band or not band},
                details=details,
                image=image,
                problem=problem,
                broken=bool(record.get("error")),
                image_path=_path(store, run_dir, address) if image else "",
                shown=shown,
                head_paths={head: _path(store, run_dir, images.get(band)) for head, images in heads.items()},
            )
        )
    return views


def _path(store: Store, run_dir: Path, address: str | None) -> str:
    """Return the path of an existing archived image relative to the run's folder."""
    try:
        return Path(os.path.relpath(store.path(address), run_dir)).as_posix() if address else ""
    except UserError:
        return ""


def _image(store: Store, address: str | None, error: str | None) -> tuple[DetectorImage | None, str]:
    if error:
        return None, f"This frame failed: {error}"
    if not address:
        return None, "The image was not stored."
    try:
        return store.read_image(address), ""
    except DamagedFileError as damage:
        return None, f"The image in the archive is damaged: {damage.what}. Run the suite again to make it anew."
    except UserError:
        return None, "The image is not in the archive any more. Run the suite again to make it anew."
