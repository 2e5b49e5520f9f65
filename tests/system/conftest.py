"""Commands as a user runs them: the installed program, in its own process, in an empty folder."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from horizonval import cli
from horizonval.jobs import engine
from horizonval.jobs.pool import get_ready
from horizonval.plugins import registry
from horizonval.suites.units import scored

PROGRAM = Path(sys.executable).with_name("horizonval")

MINI_CAMERA = """
[camera]
name = "mini"
width = 96
height = 80
fov_deg = 60.0
[optics]
f_number = 4.0
transmission = 0.7
psf_sigma_px = 0.7
[[band]]
name = "vis"
kind = "solar"
lo_um = 0.5
hi_um = 0.7
nodes = 2
[detector]
kind = "cmos"
pixel_pitch_um = 5.5
exposure_s = 2.2e-4
quantum_efficiency = 0.6
full_well_e = 13500.0
read_noise_e = 13.0
bits = 10
black_level_dn = 32.0
"""

MINI_SUITE = """
[suite]
name = "mini"
seed = 3
estimators = ["altitude-free", "ideal"]
[defaults]
camera = { file = "mini-camera.toml", mount_roll_deg = 65.0 }
platform.altitude_km = 500.0
""" + "".join(
    f'[[frame]]\nscene.name = "frame-{i}"\nplatform.latitude_deg = {10.0 * i}\nattitude.roll_deg = {i - 3.0}\n'
    for i in range(6)
)


Call = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def program(tmp_path: Path) -> Call:
    """Run the installed program in the test's folder; keyword arguments go to the environment."""

    def call(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [str(PROGRAM), *map(str, arguments)],
            cwd=tmp_path,
            env=os.environ | environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        # Whether a command is slow enough to say so hangs on what else the machine does.
        done.stderr = re.sub(r"\Ahorizonval: [a-z ]+ is getting ready\n", "", done.stderr)
        return done

    return call


@pytest.fixture
def horizonval(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Call:
    """Run a command line inside this process, which saves a program's start; an escaping exception fails the test."""

    def call(*arguments: object, folder: Path = tmp_path) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(folder)
        capfd.readouterr()
        status = cli.run_command_line([str(a) for a in arguments])
        output, errors = capfd.readouterr()
        return subprocess.CompletedProcess(["horizonval", *map(str, arguments)], status, output, errors)

    return call


def _one_by_one(work: Callable[[Any], Any], items: Iterable[Any], *_: object, **__: object) -> Iterator[Any]:
    return ((item, work(item)) for item in items)


class _Here:
    """Asks estimators in this process instead of one that may be killed."""

    spent_s = None

    def __init__(self, limits: object) -> None:
        pass

    def run(self, name: str, observation: Any) -> Any:
        return registry.run_safely(registry.get(name), observation)


@pytest.fixture(scope="module")
def here() -> Iterator[None]:
    """Make frames in this process: worker processes cost seconds to start, and the small run has them."""
    get_ready(2, True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "run_in_processes", _one_by_one)
        yield


@pytest.fixture
def estimators_here(here: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make frames and estimates in this process, and no pages."""
    monkeypatch.setattr(scored, "supervisor_of", _Here)
    monkeypatch.setattr("horizonval.report.build_report", lambda folder: folder / "report" / "index.html")


@pytest.fixture(scope="session")
def mini_suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A suite of six small frames that runs in seconds."""
    folder = tmp_path_factory.mktemp("mini")
    (folder / "mini-camera.toml").write_text(MINI_CAMERA)
    (folder / "mini.toml").write_text(MINI_SUITE)
    return folder / "mini.toml"


@pytest.fixture(scope="session")
def mini_run(mini_suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an uninterrupted run of the small suite; do not change it."""
    out = tmp_path_factory.mktemp("mini-run") / "out"
    done = subprocess.run(
        [str(PROGRAM), "run", str(mini_suite), "--out", str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return out


def _entry(run: Path, key: str) -> Path:
    address = json.loads((run / "cases" / "frame-0.json").read_text())[key]
    return run / "archive" / address[:2] / f"{address}.exr"


@pytest.fixture
def frame_path(mini_run: Path) -> Path:
    """The first frame of the small run; do not change it."""
    return _entry(mini_run, "truth_frame")


@pytest.fixture
def image_path(mini_run: Path) -> Path:
    """The first image of the small run; do not change it."""
    return _entry(mini_run, "image")


def outcome_of(out: Path) -> dict[str, str]:
    """Digest of every file that equal runs share: archive, records, summary, table and report."""
    rooms = ("archive", "cases", "state", "report")
    files = [p for room in rooms for p in (out / room).rglob("*") if p.suffix in (".exr", ".json", ".html")]
    files += [out / "summary.json", out / "results.parquet", out / "run.json"]
    return {p.relative_to(out).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(files)}


def assert_one_line(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    """The program refused politely: status 2, one line, no traceback, and the line says all of ``parts``."""
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("horizonval: error: ")
    for part in parts:
        assert part in lines[0], lines[0]
