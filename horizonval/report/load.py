"""Read the folder of a run, finished or not."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from horizonval.archive.store import Store
from horizonval.errors import DamagedFileError, UserError
from horizonval.frame import DetectorImage


@dataclass(frozen=True)
class View:
    """One band of one case: what a tile of the report shows.

    ``image`` is ``None`` where there is none; ``problem`` then says why. ``broken`` tells that the frame itself failed.
    """

    case: str
    band: str
    rows: dict[str, dict[str, Any]]
    details: dict[str, dict[str, Any]]
    image: DetectorImage | None
    problem: str
    broken: bool
    image_path: str


@dataclass(frozen=True)
class Run:
    """A run as the report needs it: views in the suite's order, and the cases without result."""

    suite: str
    title: str
    version: str
    estimators: tuple[str, ...]
    cases: tuple[str, ...]
    missing: tuple[str, ...]
    views: tuple[View, ...]

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Every row, in the order of the views."""
        return [row for view in self.views for row in view.rows.values()]


def load_run(run_dir: Path) -> Run:
    """Read ``run.json``, the case files and the detector images.

    A missing case, a missing image and a damaged image are part of what a report tells.

    Raises
    ------
    UserError
        There is no ``run.json``.
    DamagedFileError
        ``run.json`` or a case file is not what a run writes.
    """
    path = run_dir / "run.json"
    if not path.is_file():
        raise UserError("no run.json", where=str(run_dir), expected="the folder of a run")
    head = _read(path, ("suite", "estimators", "cases"))
    store = Store(run_dir / "archive")
    missing, views = [], []
    for name in head["cases"]:
        case_path = run_dir / "cases" / f"{name}.json"
        if case_path.is_file():
            record = _read(case_path, ("case", "rows", "details"))
            try:
                views += _views(record, store)
            except (KeyError, TypeError, AttributeError) as error:
                raise DamagedFileError(f"not a case's results ({error!r})", where=str(case_path)) from error
        else:
            missing.append(name)
    return Run(
        suite=head["suite"],
        title=head.get("title") or "",
        version=head.get("version") or "",
        estimators=tuple(head["estimators"]),
        cases=tuple(head["cases"]),
        missing=tuple(missing),
        views=tuple(views),
    )


def _read(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise DamagedFileError("not JSON", where=str(path), fix="run the suite again") from error
    absent = [key for key in keys if not isinstance(data, dict) or key not in data]
    if absent:
        raise DamagedFileError(f"no key {absent[0]!r}", where=str(path), fix="run the suite again")
    result: dict[str, Any] = data
    return result


def _views(record: dict[str, Any], store: Store) -> list[View]:
    images: dict[str, str] = dict(record.get("images") or {})
    if not images and record.get("image"):
        images = {"": record["image"]}
    # A failed frame has rows but no images; a frame without estimators has images but no rows.
    bands = list(dict.fromkeys([*(band for band in images if band), *(row["band"] for row in record["rows"])])) or [""]
    views = []
    for i, band in enumerate(bands):
        address = images.get(band) or (images.get("") if i == 0 else None)
        image, problem = _image(store, address, record.get("error"))
        names = {row["estimator"] for row in record["rows"]} | set(record["details"])
        details = {
            name: found
            for name in sorted(names)
            if (found := record["details"].get(name if i == 0 else f"{name} [{band}]")) is not None
        }
        views.append(
            View(
                case=record["case"],
                band=band or (image.band if image else ""),
                rows={row["estimator"]: row for row in record["rows"] if row["band"] == band or not band},
                details=details,
                image=image,
                problem=problem,
                broken=bool(record.get("error")),
                image_path=store.path(address).relative_to(store.root.parent).as_posix() if image and address else "",
            )
        )
    return views


def _image(store: Store, address: str | None, error: str | None) -> tuple[DetectorImage | None, str]:
    if error:
        return None, f"This frame failed: {error}"
    if not address:
        return None, "No image was made of this frame."
    try:
        return store.read_image(address), ""
    except DamagedFileError as damage:
        return None, f"The image in the archive is damaged: {damage.what}. Run the suite again to make it anew."
    except UserError:
        return None, "The image is not in the archive any more. Run the suite again to make it anew."
