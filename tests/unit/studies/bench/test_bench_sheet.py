"""The benchmark: its frames, what a passphrase draws, and the sheet of scores against a table worked out by hand."""

from __future__ import annotations

import hashlib

import pytest

from horizonval.core.errors import UserError
from horizonval.studies.bench.frames import bench_suite, commitment, sealed_seed
from horizonval.studies.bench.sheet import Answer, ranking, score_of, sheet_of

# Points by hand: on the bound 1; at 4 times the bound 1 / (1 + 2); a refusal where due 0; beyond half a degree -1; a
# refusal where none was due 0; 720 arcsec claimed to 100, more than five sigma, -1.
TABLE = (
    Answer("a", "a/1", True, True, error_arcsec=10.0, sigma_arcsec=10.0, bound_arcsec=10.0, nees=1.0),
    Answer("a", "a/2", True, True, error_arcsec=40.0, sigma_arcsec=20.0, bound_arcsec=10.0, nees=4.0),
    Answer("a", "a/3", True, False, bound_arcsec=10.0),
    Answer("b", "b/1", True, True, error_arcsec=1801.0, sigma_arcsec=1e6, bound_arcsec=10.0),
    Answer("b", "b/2", False, False),
    Answer("b", "b/3", False, True, error_arcsec=720.0, sigma_arcsec=100.0),
)


def test_a_table_by_hand() -> None:
    """(1 + 1/3 - 1 - 1) points over four frames that are due."""
    sheet = sheet_of(TABLE)
    assert sheet["all"]["score"] == pytest.approx(100 * (4 / 3 - 2) / 4, abs=1e-12)
    assert (sheet["all"]["due"], sheet["all"]["answered"], sheet["all"]["false"]) == (4, 3, 2)
    assert sheet["cells"]["a"]["score"] == pytest.approx(100 * (4 / 3) / 3, abs=1e-12)
    assert sheet["cells"]["a"]["median_over_bound"] == 2.5
    assert sheet["cells"]["a"]["median_error_arcsec"] == 25.0
    assert sheet["cells"]["a"]["mean_nees"] == 2.5
    assert sheet["cells"]["b"]["median_over_bound"] == pytest.approx(180.1)


@pytest.mark.parametrize(
    ("error_arcsec", "sigma_arcsec", "false"),
    [(359.0, 1.0, False), (361.0, 72.0, True), (361.0, 73.0, False), (361.0, None, True), (1799.0, 400.0, False)],
)
def test_false_claims(error_arcsec: float, sigma_arcsec: float | None, false: bool) -> None:
    """Beyond 0.1 deg and five sigma, a claim without sigma judged by 72 arcsec."""
    assert Answer("a", "a", True, True, error_arcsec, sigma_arcsec).is_false is false


def test_silence_scores_nothing() -> None:
    """Whoever never answers has 0, whoever always claims wrongly less."""
    silent = [Answer("a", str(i), i < 5, False) for i in range(10)]
    liar = [Answer("a", str(i), i < 5, True, error_arcsec=9000.0) for i in range(10)]
    assert score_of(silent) == 0.0
    assert score_of(liar) == -200.0


def test_ties_are_told() -> None:
    """Two methods that differ by chance share a rank; a third that is always worse does not."""

    def method(factor: float, name: str) -> list[Answer]:
        wobble = [1.0 + hashlib.sha256(f"{name}{i}".encode()).digest()[0] / 512 for i in range(80)]
        return [Answer("a", str(i), True, True, 10.0 * factor * wobble[i], 50.0, 10.0) for i in range(80)]

    rows = ranking({"x": method(1.5, "x"), "y": method(1.5, "y"), "z": method(20.0, "z")})
    assert {row["method"]: (row["rank"], row["tied"]) for row in rows} == {
        "x": (1, True),
        "y": (1, True),
        "z": (3, False),
    }


def test_other_frames_cannot_be_ranked() -> None:
    """A method that left frames out is not compared with one that did not."""
    with pytest.raises(ValueError, match="same frames"):
        ranking({"x": TABLE, "y": TABLE[1:]})


def test_a_passphrase_draws_other_frames_and_always_the_same() -> None:
    seed = sealed_seed("four words at random\n")
    assert seed == sealed_seed("four words at random")
    assert seed != sealed_seed("four words at Random")
    assert f"{seed:x}" not in commitment(seed)
    sealed, public = (bench_suite(s, frames_per_cell=1).cases for s in (seed, None))
    assert [case.name for case in sealed] == [case.name for case in public]
    assert all(a.scene.platform != b.scene.platform for a, b in zip(sealed, public, strict=True))


@pytest.mark.parametrize("count", [0, 51])
def test_counts_that_a_cell_has_not(count: int) -> None:
    with pytest.raises(UserError, match=str(count)):
        bench_suite(frames_per_cell=count)


def test_short_passphrases_are_refused() -> None:
    with pytest.raises(UserError, match="characters"):
        sealed_seed("short")
