"""Score the detector images of an archive again, with the estimators of today: no scene is rendered, no noise is drawn.

Image and truth come from the archived files alone. The outcome is laid out like a run's folder, without an archive of
its own, so that the report can be made of it.
"""

from __future__ import annotations

import math
import os
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from horizonval.core.code import code_version
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress, Silent
from horizonval.estimation import registry
from horizonval.estimation.observation import Estimator
from horizonval.estimation.process.sandbox import Limits, Sandbox
from horizonval.frame import DetectorImage
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_of_heads, expected_outcome
from horizonval.scoring.row import Row, make_row
from horizonval.store.entry import StoreEntry
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.index import Filter
from horizonval.store.named import run_folder_of
from horizonval.store.store import Store
from horizonval.suites.identity import rescored_identity
from horizonval.suites.observation import method_radius_m, observation_of, observation_of_heads
from horizonval.suites.record import details_of, record_of

RESCORE_SCHEMA = 1


@dataclass(frozen=True)
class Item:
    """Images that are scored together under one name: all bands of a case, or those of all heads of a scene.

    ``images`` by head (``""`` for a camera without) and band; ``frames``: the addresses of the heads' frames, empty
    where the archive has none, or several that could be meant.
    """

    name: str
    images: dict[str, dict[str, str]]
    frames: dict[str, str]
    together: bool = False


@dataclass(frozen=True)
class Rescored:
    """Content of ``summary.json``, images without a result and why, and the report's first page."""

    summary: dict[str, Any]
    failed: dict[str, str]
    report: Path


def rescore(
    store: Store,
    out: Path,
    estimators: Sequence[str] = (),
    wanted: Filter | None = None,
    workers: int = 1,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Rescored:
    """Score the images of an archive, or finish what an earlier call left in ``out``.

    Parameters
    ----------
    store : Store
    out : Path
        Made if need be.
    estimators : sequence of str
        By default those of the run that the archive belongs to.
    wanted : Filter, optional
        Which images.
    workers : int
        Estimates at the same time; the number changes no result.
    limits : Limits, optional
        Of one estimate.
    progress : Progress, optional

    Raises
    ------
    UserError
        Unknown estimators, no images, or a folder that holds something else.
    """
    progress, limits = progress or Silent(), limits or Limits()
    run = run_folder_of(store.root)
    head = (read_json(run.suite) if run else None) or {}
    chosen = [registry.get(name) for name in estimators or head.get("estimators", ())]
    if not chosen:
        raise UserError("which estimators?", where="--estimator", fix="see `horizonval list estimators`")
    entries = [entry for entry in store.index.select() if entry.kind == "frame"]
    entries += [entry for entry in store.index.select(wanted) if entry.kind == "image"]
    items = items_of(entries, chosen)
    # In the order of the suite, as far as it is known.
    place = {name: number for number, name in enumerate(head.get("cases", ()))}
    items.sort(key=lambda item: place.get(item.name, len(place)))
    if not items:
        raise UserError("no detector image to score", where=str(store.root), fix="see `horizonval archive ls`")
    folder = RunFolder(out)
    _claim(folder, store, head, chosen, items)
    failed: dict[str, str] = {}
    rows: list[Row] = []
    with folder.locked():
        progress.start(len(items), 0)
        for item, record in _records(items, store, chosen, folder, workers, limits):
            if isinstance(record, str):
                failed[item.name] = record
            else:
                rows += [Row.from_dict(row) for row in record["rows"]]
            progress.done(item.name, failed=failed.get(item.name))
        return _conclude(folder, head, rows, failed)


def items_of(entries: Sequence[StoreEntry], estimators: Sequence[Estimator]) -> list[Item]:
    """Group images by scene, camera, instant and draw of noise, and name the groups.

    The name is the scene's; with the head's where images of several heads are of one scene, as in a run. What would
    then have the same name (other seeds, exposures or cameras of a scene) has the beginning of its address behind it.
    """
    frames: dict[tuple[str, str], list[str]] = {}
    groups: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    for entry in entries:
        if entry.kind == "frame":
            frames.setdefault((entry.scene_id, entry.head), []).append(entry.address)
        elif entry.kind == "image":
            key: tuple[str, ...] = (entry.scene, entry.camera, entry.epoch_utc, entry.seed)
            # A head changes the scene's identity; without heads it tells what has the same name apart.
            key += ("",) if entry.head else (entry.scene_id,)
            by_band = groups.setdefault(key, {}).setdefault(entry.head, {})
            band = entry.bands[0]
            if band in by_band:
                by_band = groups.setdefault((*key, entry.address), {}).setdefault(entry.head, {})
            by_band[band] = entry.address
    scene_ids = {entry.address: entry.scene_id for entry in entries}
    alone = any(estimator.needs != "heads" for estimator in estimators)
    together = any(estimator.needs == "heads" for estimator in estimators)
    items = []
    for (scene, *_), heads in groups.items():
        of_heads = {}
        for name, images in heads.items():
            found = frames.get((scene_ids[next(iter(images.values()))], name), [])
            of_heads[name] = found[0] if len(found) == 1 else ""
        several = len(heads) > 1
        if alone:
            items += [
                Item(f"{scene}.{name}" if several else scene, {name: images}, {name: of_heads[name]})
                for name, images in heads.items()
            ]
        if together and several:
            items.append(Item(scene, heads, of_heads, together=True))
    return _named_apart(items)


def _named_apart(items: Sequence[Item]) -> list[Item]:
    count = Counter(item.name for item in items)
    named = []
    for item in items:
        address = min(address for images in item.images.values() for address in images.values())
        named.append(replace(item, name=f"{item.name}.{address[:12]}") if count[item.name] > 1 else item)
    return sorted(named, key=lambda item: item.name)


def _claim(
    folder: RunFolder, store: Store, head: dict[str, Any], chosen: Sequence[Estimator], items: Sequence[Item]
) -> None:
    before = read_json(folder.suite)
    if (before is not None and "rescored" not in before) or folder.archive.exists():
        raise UserError("holds a run", where=str(folder.root), fix="choose another --out")
    for path in (folder.root, folder.cases):
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as e:
            raise UserError(e.strerror or "cannot be created", where=str(path)) from e
    names = [item.name for item in items]
    for path in folder.cases.glob("*.json"):
        if path.stem not in names:
            path.unlink()
    write_json(
        folder.suite,
        {
            "schema": RESCORE_SCHEMA,
            "rescored": True,
            "suite": head.get("suite") or store.root.name,
            "title": " ".join(filter(None, [str(head.get("title") or ""), "(scored again)"])),
            "version": code_version(),
            "estimators": [estimator.name for estimator in chosen],
            "cases": names,
            "archive": Path(os.path.relpath(store.root, folder.root)).as_posix(),
        },
    )


def _records(
    items: Sequence[Item],
    store: Store,
    chosen: Sequence[Estimator],
    folder: RunFolder,
    workers: int,
    limits: Limits,
) -> Iterator[tuple[Item, dict[str, Any] | str]]:
    """Yield every item with its record, or why there is none, as they come.

    The estimates run in processes of their own; a thread for each waits for it.
    """
    own = threading.local()
    opened: list[Sandbox] = []
    stopped = threading.Event()

    def work(item: Item) -> dict[str, Any] | str:
        if not hasattr(own, "sandbox"):
            own.sandbox = Sandbox(limits)
            opened.append(own.sandbox)
        return _record(item, store, chosen, folder, own.sandbox, stopped)

    waiting = iter(items)
    pool = ThreadPoolExecutor(max(1, workers))
    under_way: dict[Future[dict[str, Any] | str], Item] = {}
    try:
        while True:
            for item in waiting:
                under_way[pool.submit(work, item)] = item
                if len(under_way) >= 2 * workers:
                    break
            if not under_way:
                return
            ready, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in ready:
                yield under_way.pop(future), future.result()
    finally:
        stopped.set()
        for sandbox in opened:
            sandbox.close()
        pool.shutdown(wait=True, cancel_futures=True)


def _record(
    item: Item,
    store: Store,
    chosen: Sequence[Estimator],
    folder: RunFolder,
    sandbox: Sandbox,
    stopped: threading.Event,
) -> dict[str, Any] | str:
    estimators = [one for one in chosen if (one.needs == "heads") == item.together]
    addresses = [address for images in item.images.values() for address in images.values()]
    identity = rescored_identity([*addresses, *item.frames.values()], [one.name for one in estimators])
    path = folder.case(item.name)
    before = read_json(path)
    if before is not None and before.get("identity") == identity and before.get("error") is None:
        return before
    try:
        images = {
            head: {band: store.read_image(address) for band, address in sorted(by_band.items())}
            for head, by_band in item.images.items()
        }
    except UserError as error:
        return error.line()
    images = _in_order(images)
    first = next(iter(images))
    truth = next(iter(images[first].values())).truth
    # The report draws the first band; it is the camera file's first, as in a run.
    order = [band.name for band in truth.camera_spec.band]
    bands = sorted(images[first], key=lambda band: (order.index(band) if band in order else len(order), band))
    rows, details = [], {}
    for number, band in enumerate(bands):
        if any(band not in of_head for of_head in images.values()):
            continue
        taken = {head: of_head[band] for head, of_head in images.items()}
        for estimator in estimators:
            row, drawn = _scored(item, taken, estimator, sandbox)
            rows.append(row)
            details[estimator.name if number == 0 else f"{estimator.name} [{band}]"] = drawn
    addresses_of = {"": item.frames.get(first) or None, **item.images[first]}
    known = {key: value for key, value in addresses_of.items() if value}
    record = record_of(item.name, identity, truth, rows, details, known)
    if stopped.is_set():  # Its process was ended from here, which is no failure of the estimator.
        return "interrupted"
    write_json(path, record, indent=None)
    return record


def _in_order(images: dict[str, dict[str, DetectorImage]]) -> dict[str, dict[str, DetectorImage]]:
    """Return heads in the order of the camera file, which decides whose camera frame an answer is in."""
    truth = next(iter(next(iter(images.values())).values())).truth
    order = [head.name for head in truth.camera_spec.head]
    return {name: images[name] for name in sorted(images, key=lambda h: (order.index(h) if h in order else -1, h))}


def _scored(
    item: Item, taken: dict[str, DetectorImage], estimator: Estimator, sandbox: Sandbox
) -> tuple[Row, dict[str, Any]]:
    image = next(iter(taken.values()))
    truth = image.truth
    if item.together:
        observation = observation_of_heads(taken, estimator)
        expected = expected_of_heads([expected_outcome(i.truth, i.band, needs="heads") for i in taken.values()])
    else:
        observation = observation_of(image, estimator)
        expected = expected_outcome(truth, image.band, needs=estimator.needs)
    result = sandbox.run(estimator.name, observation)
    row = make_row(
        case=item.name,
        camera=truth.camera_name,
        band=image.band,
        estimator=estimator.name,
        truth=truth,
        expected=expected,
        score=score(truth, estimator, result, earth_radius_m=method_radius_m(truth)),
    )
    # The Sun troubles the head it is nearest to, which need not be the first.
    nearest_rad = min(other.truth.sun_boresight_rad for other in taken.values())
    return replace(row, sun_boresight_deg=math.degrees(nearest_rad)), details_of(result)


def _conclude(folder: RunFolder, head: dict[str, Any], rows: list[Row], failed: dict[str, str]) -> Rescored:
    from horizonval.report import build_report
    from horizonval.scoring.summary import summarise
    from horizonval.scoring.table import write_results

    rows.sort(key=lambda row: row.sort_key)
    summary = {"suite": head.get("suite"), "version": code_version(), "failed": failed, **summarise(rows)}
    write_results(rows, folder.results)
    write_json(folder.summary, summary)
    return Rescored(summary, failed, build_report(folder.root))
