"""The frames of the benchmark: what is frozen, and what a passphrase draws."""

from __future__ import annotations

from collections import Counter

import pytest

from horizonval.core.errors import UserError
from horizonval.studies.bench.frames import bench_suite, cell_of, commitment, sealed_seed


def test_forty_cells_of_as_many_frames() -> None:
    """Every cell has the number that was asked for."""
    counts = Counter(cell_of(case.name) for case in bench_suite(frames_per_cell=2).cases)
    assert len(counts) == 40
    assert set(counts.values()) == {2}


def test_fewer_frames_are_the_first_of_more() -> None:
    """A part of the suite is a part of the same suite."""
    few = {case.name.rpartition("_")[0]: case.scene for case in bench_suite(frames_per_cell=1).cases}
    more = {case.name.rpartition("_")[0]: case.scene for case in reversed(bench_suite(frames_per_cell=2).cases)}
    assert {name: scene.platform for name, scene in few.items()} == {
        name: scene.platform for name, scene in more.items()
    }


def test_a_passphrase_draws_other_frames_and_always_the_same() -> None:
    """The seed follows from the passphrase alone; the commitment is another number."""
    seed = sealed_seed("four words at random\n")
    assert seed == sealed_seed("four words at random")
    assert seed != sealed_seed("four words at Random")
    assert f"{seed:x}" not in commitment(seed)
    sealed, public = (bench_suite(s, frames_per_cell=1).cases for s in (seed, None))
    assert [case.name for case in sealed] == [case.name for case in public]
    assert all(a.scene.platform != b.scene.platform for a, b in zip(sealed, public, strict=True))


@pytest.mark.parametrize("count", [0, 51])
def test_counts_that_a_cell_has_not(count: int) -> None:
    """One line says what can be asked for."""
    with pytest.raises(UserError, match=str(count)):
        bench_suite(frames_per_cell=count)


def test_short_passphrases_are_refused() -> None:
    """What can be found by trying seals nothing."""
    with pytest.raises(UserError, match="characters"):
        sealed_seed("short")
