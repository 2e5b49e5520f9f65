"""Which frames the benchmark has: a public suite of a seed that all know, and sealed ones of a passphrase.

A sealed suite has the cells of the public one and a seed that follows from a passphrase by scrypt, so that it can be
neither guessed nor chosen for its outcome once its commitment is published. The passphrase is nowhere written; the
commitment, a digest of the seed, lets everyone check afterwards that the seed was fixed before.
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
"""Of methods of one image, and of those of several heads at once; a file of each name beside this one defines them."""
FRAMES_PER_CELL = 50
SHORTEST_PASSPHRASE = 12
"""Characters; a shorter one could be found by trying."""
_SEED_SALT = b"horizonval bench 1 seed"
_COMMITMENT_LABEL = b"horizonval bench 1 commitment\0"


def sealed_seed(passphrase: str) -> int:
    """Return the seed of a sealed suite, below 2**62.

    ``passphrase``: white space at its ends does not count: a file ends with a new line. Raises ``UserError``: it is too
    short.
    """
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
    """Return what is published of a sealed seed before it is used: a digest, in hexadecimal digits."""
    return hashlib.sha256(_COMMITMENT_LABEL + seed.to_bytes(8, "big")).hexdigest()


def bench_suite(seed: int | None = None, frames_per_cell: int = FRAMES_PER_CELL, group: Group = "frames") -> Suite:
    """Return the suite of one group of the benchmark.

    ``seed`` (optional): of a sealed suite; without it the public one. ``frames_per_cell``: fewer than all are the first
    of all. Raises ``UserError``: more frames than a cell has, or none.
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
