"""Frames of the benchmark: a public suite with a known seed, and sealed suites with the seed of a passphrase.

The seed of a sealed suite follows from a passphrase by scrypt, so it can be neither guessed nor chosen for its outcome.
The published commitment, a digest of the seed, proves later that the seed was fixed before. The passphrase is stored
nowhere.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Literal

from horizonval.core.errors import UserError
from horizonval.spec.load import Suite
from horizonval.suites.suite import load_suite

Group = Literal["frames", "heads"]
CELLS: dict[Group, int] = {"frames": 40, "heads": 4}
"""Names of the groups: methods of one image, and methods of several heads. The file of that name defines the cells."""
FRAMES_PER_CELL = 50
SHORTEST_PASSPHRASE = 12
"""Minimum length of a passphrase, characters."""
_SEED_SALT = b"horizonval bench 1 seed"
_COMMITMENT_LABEL = b"horizonval bench 1 commitment\0"


def sealed_seed(passphrase: str) -> int:
    """Return the seed of a sealed suite, below 2**62. Raises ``UserError``: the passphrase is too short."""
    text = passphrase.strip()
    if len(text) < SHORTEST_PASSPHRASE:
        raise UserError(
            f"has {len(text)} characters",
            where="the passphrase",
            expected=f"at least {SHORTEST_PASSPHRASE}",
            fix="draw some words at random",
        )
    key = hashlib.scrypt(text.encode(), salt=_SEED_SALT, n=2**14, r=8, p=1, dklen=8)
    return int.from_bytes(key, "big") >> 2


def commitment(seed: int) -> str:
    """Return the published digest of a sealed seed, hexadecimal."""
    return hashlib.sha256(_COMMITMENT_LABEL + seed.to_bytes(8, "big")).hexdigest()


def bench_suite(seed: int | None = None, frames_per_cell: int = FRAMES_PER_CELL, group: Group = "frames") -> Suite:
    """Return the suite of one group; ``seed`` is that of a sealed suite, None the public one.

    Fewer ``frames_per_cell`` are the first of all. Raises ``UserError``: more frames than a cell has, or none.
    """
    if not 1 <= frames_per_cell <= FRAMES_PER_CELL:
        raise UserError(
            f"found {frames_per_cell}", where="--frames-per-cell", expected=f"a number from 1 to {FRAMES_PER_CELL}"
        )
    definition = Path(__file__).with_name(f"{group}.toml")
    suite = load_suite(definition, frames=CELLS[group] * frames_per_cell, seed=seed)
    return replace(suite, keep="all")


def cell_of(case: str) -> str:
    """Return the cell that a frame belongs to, of the name of its case."""
    return case.partition("_")[0]
