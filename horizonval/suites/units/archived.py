"""Units made of the images of an archive and scored, without rendering.

Image and truth come from the archived files alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from horizonval.core.errors import UserError
from horizonval.estimation.observation import Estimator
from horizonval.jobs.progress import Stopwatch
from horizonval.spec.prior import is_climate_file
from horizonval.store.entry import StoreEntry
from horizonval.store.exr import read_header
from horizonval.store.store import Store
from horizonval.suites.plan import CasePlan
from horizonval.suites.record import Record, record_of
from horizonval.suites.units.scored import Observed, score_alone, score_together


@dataclass(frozen=True)
class Item:
    """Images that are scored together: all bands of a case, or those of all heads of a scene.

    ``images``: by head (``""`` for a camera without heads) and band. ``frames``: addresses of the heads' frames, empty
    if missing or ambiguous.
    """

    name: str
    images: dict[str, dict[str, str]]
    frames: dict[str, str]
    together: bool = False

    @property
    def image_addresses(self) -> list[str]:
        return [address for images in self.images.values() for address in images.values()]

    @property
    def addresses(self) -> list[str]:
        return [*self.image_addresses, *self.frames.values()]

    def estimators(self, plan: CasePlan) -> list[str]:
        """Return the estimators for this item: methods of one image, or of all heads."""
        return [name for name in plan.estimators if (plan.estimator(name).needs == "heads") == self.together]


def archived_record(item: Item, plan: CasePlan, store: Store, watch: Stopwatch) -> Record:
    """Return the record of archived images. Raises ``UserError``: a missing or damaged file."""
    heads = _in_order({head: _observed(images.values(), store) for head, images in item.images.items()})
    first = next(iter(heads))
    if item.together:
        scored = score_together(heads, item.name, item.estimators(plan), plan, watch)
    else:
        scored = heads[first]
        score_alone(scored, item.name, item.estimators(plan), plan, watch)
    addresses = {"": item.frames.get(first) or None, **item.images[first]}
    known = {band: address for band, address in addresses.items() if address}
    return record_of(item.name, scored.truth, scored.rows, scored.details, known)


def climates_of(item: Item, store: Store) -> set[Path]:
    """Return the climate files in the priors of an item's images, equal for one scene."""
    found = set()
    for images in item.images.values():
        try:
            truth = read_header(store.path(next(iter(images.values()))))["truth"]
        except UserError:
            # scoring will report the error
            continue
        climate = (truth["scene"].get("prior") or {}).get("climate")
        if climate is not None and is_climate_file(climate):
            found.add(Path(climate))
    return found


def _observed(addresses: Iterable[str], store: Store) -> Observed:
    """Read images; bands are in the camera file's order, as in a run."""
    images = [store.read_image(address) for address in addresses]
    order = [band.name for band in images[0].truth.camera_spec.band]
    images.sort(key=lambda image: (order.index(image.band) if image.band in order else len(order), image.band))
    return Observed({image.band: image for image in images})


def _in_order(heads: dict[str, Observed]) -> dict[str, Observed]:
    """Return heads in the order of the camera file; answers are in the camera frame of the first."""
    order = [head.name for head in next(iter(heads.values())).truth.camera_spec.head]
    return {name: heads[name] for name in sorted(heads, key=lambda h: (order.index(h) if h in order else -1, h))}


def items_of(entries: Sequence[StoreEntry], estimators: Sequence[Estimator]) -> list[Item]:
    """Group images by scene, camera, instant and noise sample, and name the groups.

    The name is the scene's, with the head's for images of several heads, as in a run. Other groups of the same name
    (other seeds, exposures or cameras) get the beginning of their address as suffix.
    """
    frames: dict[tuple[str, str], list[str]] = {}
    groups: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    for entry in entries:
        if entry.kind == "frame":
            frames.setdefault((entry.scene_id, entry.head), []).append(entry.address)
        elif entry.kind == "image":
            key: tuple[str, ...] = (entry.scene, entry.camera, entry.epoch_utc, entry.seed)
            # A head changes the scene's identity; without heads it distinguishes equal names.
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


def cases_of_heads(items: Iterable[Item]) -> dict[str, list[list[str]]]:
    """Return [head, name] of the single-head items of every item of all heads, in order."""
    listed = list(items)
    heads: dict[str, list[list[str]]] = {item.name: [] for item in listed if item.together}
    together = {address: item.name for item in listed if item.together for address in item.image_addresses}
    for item in listed:
        scene = together.get(item.image_addresses[0])
        if not item.together and scene is not None:
            (head,) = item.images
            heads[scene].append([head, item.name])
    return heads


def _named_apart(items: Sequence[Item]) -> list[Item]:
    count = Counter(item.name for item in items)
    named = []
    for item in items:
        address = min(address for images in item.images.values() for address in images.values())
        named.append(replace(item, name=f"{item.name}.{address[:12]}") if count[item.name] > 1 else item)
    return sorted(named, key=lambda item: item.name)
