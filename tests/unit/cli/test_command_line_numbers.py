"""Numbers of the command line have the limits of the files' keys, and are judged before any work is done."""

from __future__ import annotations

import time

import pytest

from horizonval import cli
from horizonval.core.errors import UserError
from horizonval.jobs.pool import Execution, parse_shard
from horizonval.spec.explain import with_option
from horizonval.spec.suite import Requirement, SobolSpec, SuiteHead

LONG = "9" * 5000
"""More digits than Python turns into a number."""


@pytest.mark.parametrize(
    ("arguments", "option", "expected"),
    [
        ("run strict --out o --frames 1000000000", "--frames", "1000000"),
        ("run strict --out o --seed -1", "--seed", "0"),
        ("run quick --out o --workers 1000000000", "--workers", "4096"),
        ("run quick --out o --time-limit inf", "--time-limit", "above 0"),
        ("run quick --out o --shard 2/1", "--shard", "1 to n"),
        ("run quick --out o --shard 1/1000000000", "--shard", "1000000"),
        (f"run quick --out o --shard 1/{LONG}", "--shard", "1000000"),
        ("run quick --out o --dask local:1000000000", "--dask", "4096"),
        ("render limb-noon-vis -o a.exr --reference --spp 1000000000", "--spp", "1000000"),
        ("render limb-noon-vis -o a.exr --reference --reference-size 99999x99999", "--reference-size", "16384"),
        ("sheet a.exr -o a.png --columns 1000000000", "--columns", "40"),
    ],
)
def test_a_number_out_of_range_is_one_line_at_once(arguments, option, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    start = time.process_time()
    assert cli.run_command_line(arguments.split()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert len(error) < 6000
    assert option in error
    assert expected in error
    assert time.process_time() - start < 10.0
    assert not any(tmp_path.iterdir())


def test_an_option_is_checked_as_the_key_it_stands_for():
    head = SuiteHead(name="a", estimators=["ideal"], frames=5, title="kept")
    changed = with_option(head, "frames", 7, "--frames")
    assert (changed.frames, changed.title, changed.model_fields_set) == (7, "kept", head.model_fields_set)
    with pytest.raises(UserError, match=r"^--frames: found 1000001; expected a whole number from 1 to 1000000$"):
        with_option(head, "frames", 1_000_001, "--frames")
    with pytest.raises(UserError, match=r"^--error-deg: found nan; expected a number above 0$"):
        with_option(Requirement(), "error_deg", float("nan"), "--error-deg")
    with pytest.raises(UserError, match=r"^--n: give one of n and share$"):
        with_option(SobolSpec(n=3, ranges={"a": [0, 1]}), "share", 0.5, "--n")


def test_an_execution_has_a_bounded_number_of_processes():
    assert Execution(4096).processes == 4096
    for workers in (0, 4097):
        with pytest.raises(UserError, match="--workers"):
            Execution(workers)
    assert parse_shard("2/1000000") == (2, 1_000_000)
