"""Limits of numbers on the command line, other seeds, interruptions and foreign exits."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from horizonval import cli
from horizonval.cli.output import interruptible, resumable, written
from horizonval.core.errors import UserError
from horizonval.jobs.pool import Execution, parse_shard
from horizonval.spec.explain import with_option
from horizonval.spec.files import shipped_path
from horizonval.spec.requirement import Requirement
from horizonval.spec.suite import SobolSpec, SuiteHead
from horizonval.suites.suite import load_suite

LATE = {"mitsuba", "drjit", "numpy", "scipy", "cv2", "OpenEXR", "pydantic", "rich", "duckdb", "matplotlib"}
"""numpy also because the number of its threads is fixed after this import, before numpy's own."""


def test_import_loads_nothing_heavy():
    code = "import sys, horizonval.cli; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "typer" in loaded
    assert not loaded & LATE


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "horizonval", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("horizonval ")
    done = subprocess.run([sys.executable, "-m", "horizonval", "rendr"], capture_output=True, text=True)
    assert done.returncode == 2


@pytest.mark.parametrize(
    ("kept", "line"),
    [
        (None, "horizonval: interrupted; the same command goes on from here\n"),
        ("units", "horizonval: interrupted; finished units are saved, the same command goes on from here\n"),
    ],
)
def test_an_interruption_is_one_line_and_status_130(kept, line, capsys):
    with pytest.raises(SystemExit) as end, resumable("night", "units", kept=kept):
        raise KeyboardInterrupt
    assert end.value.code == 130
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(
    ("end", "status"),
    [(SystemExit(0), 1), (SystemExit(None), 1), (SystemExit(3), 3), (BrokenPipeError(), 1), (KeyboardInterrupt(), 130)],
)
def test_who_ends_work_early_does_not_say_that_it_is_done(end: BaseException, status: int) -> None:
    with pytest.raises(SystemExit) as ended, interruptible():
        raise end
    assert ended.value.code == status


def test_a_run_that_somebody_ends_with_status_0_has_not_succeeded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("horizonval.api.run.run_suite", lambda *_, **__: sys.exit(0))
    with pytest.raises(SystemExit) as ended:
        cli.run_command_line(["run", "quick", "--out", str(tmp_path / "out")])
    assert ended.value.code == 1
    assert "before the work was done" in capsys.readouterr().err


def test_another_seed_draws_other_scenes(monkeypatch, tmp_path):
    taken = []

    def take(suite, out, **_):
        taken.append(suite)
        raise UserError("enough")

    monkeypatch.setattr("horizonval.api.run.run_suite", take)
    for seed in ("1", "9"):
        assert cli.run_command_line(["run", "strict", "--frames", "40", "--seed", seed, "--out", str(tmp_path)]) == 2
    own = load_suite("strict", 40)
    assert own.seed == 1
    same, other = taken
    assert (same.seed, other.seed) == (1, 9)
    assert [case.scene for case in same.cases] == [case.scene for case in own.cases]
    names = {case.name for case in other.cases}
    assert names == {case.name for case in own.cases}
    assert not {c.scene.model_dump_json() for c in other.cases} & {c.scene.model_dump_json() for c in own.cases}


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
        with_option(Requirement(id="R", error_deg=1.0, n_sigma=3), "error_deg", float("nan"), "--error-deg")
    with pytest.raises(UserError, match=r"^--n: give one of n and share$"):
        with_option(SobolSpec(n=3, ranges={"a": [0, 1]}), "share", 0.5, "--n")


def test_an_execution_has_a_bounded_number_of_processes():
    assert Execution(4096).processes == 4096
    for workers in (0, 4097):
        with pytest.raises(UserError, match="--workers"):
            Execution(workers)
    assert parse_shard("2/1000000") == (2, 1_000_000)


ROS = "image_width: 64\nimage_height: 48\ndistortion_model: plumb_bob\n"
ROS += "".join(
    f"{key}: {{rows: 1, cols: {len(data)}, data: {data}}}\n"
    for key, data in (("camera_matrix", [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1]), ("distortion_coefficients", [0] * 5))
)


@pytest.mark.parametrize("out", ["c.yaml", "../d/c.yaml", "symbolic", "hard", "base.toml"])
def test_an_output_never_replaces_what_the_command_reads(out, tmp_path, monkeypatch, capsys):
    (tmp_path / "d").mkdir()
    monkeypatch.chdir(tmp_path / "d")
    Path("c.yaml").write_text(ROS)
    Path("base.toml").write_bytes(shipped_path("camera", "vis-cmos-512-60deg").read_bytes())
    Path("symbolic").symlink_to("c.yaml")
    Path("hard").hardlink_to("c.yaml")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    assert cli.run_command_line(["camera", "c.yaml", "--base", "./base.toml", "-o", out]) == 2
    said = f"horizonval: error: {out}: is read by this command, which would replace it; name another file\n"
    assert capsys.readouterr().err == said
    assert {path: path.read_bytes() for path in Path().iterdir()} == before
    assert cli.run_command_line(["camera", "c.yaml", "-o", "new.toml"]) == 0
    assert cli.run_command_line(["camera", "c.yaml", "-o", "new.toml"]) == 0


@pytest.mark.skipif(os.name != "posix", reason="no pipes with names")
def test_an_output_goes_into_a_pipe_or_device_and_through_a_link_to_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(ROS)
    os.mkfifo("pipe")
    Path("null").symlink_to(os.devnull)
    Path("link").symlink_to("target")
    Path("target").touch()
    assert cli.run_command_line(["camera", "c.yaml"]) == 0
    text = capsys.readouterr().out
    with ThreadPoolExecutor() as pool:
        read = pool.submit(Path("pipe").read_text)
        assert [cli.run_command_line(["camera", "c.yaml", "-o", out]) for out in ("pipe", "null", "link")] == [0, 0, 0]
        assert read.result(timeout=20) == text
    assert Path("target").read_text() == text
    assert Path("pipe").is_fifo()
    assert Path(os.devnull).is_char_device()
    assert sorted(os.listdir()) == ["c.yaml", "link", "null", "pipe", "target"]
    with pytest.raises(UserError, match=r"^pipe: is wrong$"), written(Path("pipe")) as path:
        raise UserError("is wrong", where=str(path))
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind("socket")
        assert cli.run_command_line(["camera", "c.yaml", "-o", "socket"]) == 2
    assert "socket: is a socket; expected the path of a file" in capsys.readouterr().err
