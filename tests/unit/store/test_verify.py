"""What happens to files on discs: every damage is found, and nothing else is reported."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from horizonval.store.store import Store
from horizonval.store.verify import Finding

KINDS = ("flipped", "truncated", "swapped", "deleted", "renamed", "moved", "overwritten", "copied")


def filled(root: Path, make_image, count: int) -> Store:
    """An archive of so many tiny images, all different, and its index."""
    store = Store(root)
    camera = {
        "camera": {"name": "tiny", "width": 6, "height": 4, "fov_deg": 20.0},
        "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
    }
    image = make_image(camera=camera)
    for number in range(count):
        dn = np.random.default_rng(number).integers(0, 1024, image.dn.shape).astype(np.uint16)
        store.add_image(replace(image, dn=dn, observation={"seed": number}))
    store.index.update()
    return store


def damaged(store: Store, count: int, seed: int) -> tuple[set[tuple[Path, str]], Counter[str]]:
    """Do ``count`` random damages to different entries; return what must be found, and how many of each kind."""
    rng = np.random.default_rng(seed)
    addresses = [entry.address for entry in store.entries()]
    victims = [store.path(addresses[i]) for i in rng.permutation(len(addresses))]
    expected: set[tuple[Path, str]] = set()
    done: Counter[str] = Counter()
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        done[kind] += 1
        path = victims.pop()
        data = path.read_bytes()
        if kind == "flipped":
            position = int(rng.integers(len(data)))
            path.write_bytes(
                data[:position] + bytes([data[position] ^ 1 << int(rng.integers(8))]) + data[position + 1 :]
            )
            expected.add((path, "damaged"))
        elif kind == "truncated":
            path.write_bytes(data[: int(rng.integers(len(data)))])
            expected.add((path, "damaged"))
        elif kind == "swapped":
            other = victims.pop()
            path.write_bytes(other.read_bytes())
            other.write_bytes(data)
            expected |= {(path, "damaged"), (other, "damaged")}
        elif kind == "deleted":
            path.unlink()
            expected.add((path, "missing"))
        elif kind in ("renamed", "moved"):
            # To an address that is not its own, to a name that is no address, or into another folder.
            new = store.path(rng.bytes(32).hex())
            if kind == "moved":
                new = store.root / ("ff" if path.parent.name != "ff" else "00") / path.name
            elif done[kind] % 2:
                new = path.with_name(f"{path.name}.bak")
            new.parent.mkdir(exist_ok=True)
            path.rename(new)
            expected |= {(path, "missing"), (new, "damaged" if new == store.path(new.stem[:64]) else "foreign")}
        elif kind == "overwritten":
            other = victims.pop()
            path.replace(other)
            expected |= {(path, "missing"), (other, "damaged")}
        else:
            new = path.with_name(f"copy-{number}.exr")
            new.write_bytes(data)
            expected.add((new, "foreign"))
    return expected, done


def found(findings: list[Finding]) -> set[tuple[Path, str]]:
    assert all("\n" not in finding.message for finding in findings)
    assert len({finding.path for finding in findings}) == len(findings)
    return {(finding.path, finding.problem) for finding in findings}


def check(store: Store, count: int) -> None:
    assert store.verify() == []
    expected, done = damaged(store, count, seed=20260320)
    assert min(done[kind] for kind in KINDS) >= count // len(KINDS)
    assert found(store.verify()) == expected
    # Nothing was changed by looking.
    assert found(store.verify()) == expected


def test_every_damage_is_found_and_nothing_else(tmp_path, make_image):
    check(filled(tmp_path / "archive", make_image, 60), 24)


@pytest.mark.slow
def test_two_hundred_damages_among_two_thousand_files(tmp_path, make_image):
    check(filled(tmp_path / "archive", make_image, 2000), 200)


def test_without_an_index_deletions_are_known_to_those_who_name_them(tmp_path, make_image):
    store = filled(tmp_path / "archive", make_image, 4)
    gone, kept = sorted(entry.address for entry in store.entries())[:2]
    store.path(gone).unlink()
    store.index.path.unlink()
    assert store.verify() == []
    (finding,) = store.verify({gone: "the frame 'noon'", kept: "the frame 'noon'"})
    assert (finding.problem, finding.address, finding.path) == ("missing", gone, store.path(gone))
    assert "though the frame 'noon' names it" in finding.message


def test_links_and_foreign_folders(tmp_path, make_image):
    store = filled(tmp_path / "archive", make_image, 3)
    first, second, _ = (store.path(entry.address) for entry in store.entries())
    # What a link leads to is none of the archive's, even if its bytes are right today.
    first.rename(tmp_path / "elsewhere")
    first.symlink_to(tmp_path / "elsewhere")
    assert found(store.verify()) == {(first, "damaged")}
    second.unlink()
    second.symlink_to(tmp_path / "nowhere")
    (store.root / "more").symlink_to(tmp_path)
    (store.root / ".0123.tmp").write_bytes(b"half")
    (store.root / "index.parquet").write_text("made from the headers")
    (store.root / "ab" / "cd").mkdir(parents=True)
    (store.root / "ab" / "cd" / "notes.txt").write_text("mine")
    assert found(store.verify()) == {
        (first, "damaged"),
        (second, "damaged"),
        (store.root / "more", "foreign"),
        (store.root / ".0123.tmp", "leftover"),
        (store.root / "ab" / "cd" / "notes.txt", "foreign"),
    }
