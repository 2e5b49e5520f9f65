"""Damage to any file of a run's folder: verify finds it, nothing hangs or breaks, and the same command mends it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from conftest import MINI_CAMERA

from horizonval import cli
from horizonval.core import atomic
from horizonval.jobs.pool import Execution
from horizonval.suites.run import run_suite as run
from horizonval.suites.suite import load_suite

SUITE = """
[suite]
name = "tiny"
estimators = ["altitude-free", "ideal"]
[defaults]
camera = { file = "camera.toml", mount_roll_deg = 65.0 }
platform.altitude_km = 500.0
render = { orders = "single", nodes = 16, subsamples = 1 }
[[frame]]
scene.name = "a"
[[frame]]
scene.name = "b"
platform.latitude_deg = 40.0
"""
OF_THE_CLOCK = {"timings.json", "manifest.json"}
"""What two equal runs do not share: seconds, and their digest."""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny")
    camera = MINI_CAMERA.replace("96", "48").replace("80", "40").replace("nodes = 2", "nodes = 1")
    (folder / "camera.toml").write_text(camera)
    (folder / "tiny.toml").write_text(SUITE)
    return folder / "tiny.toml"


@pytest.fixture(scope="module")
def finished(here: None, suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an undisturbed run; do not change it."""
    out = tmp_path_factory.mktemp("finished") / "out"
    finish(suite, out)
    return out


def finish(suite: Path, out: Path) -> None:
    assert not run(load_suite(suite), out, execution=Execution(1)).failed


def problems_of(out: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, str]]:
    """What verify says, and that its status is that of what it says."""
    capsys.readouterr()
    status = cli.run_command_line(["archive", "verify", str(out), "--json"])
    text = capsys.readouterr().out
    found: list[dict[str, str]] = json.loads(text)["problems"]
    assert status == (1 if found else 0)
    return found


def files_of(out: Path) -> list[Path]:
    """Every file but those of locks, whose absence means nothing and which are empty."""
    return sorted(path for path in out.rglob("*") if path.is_file() and not path.name.startswith(".lock"))


def content_of(out: Path) -> dict[str, bytes]:
    """What equal runs share."""
    shared = {path.relative_to(out).as_posix(): path for path in files_of(out)}
    return {name: path.read_bytes() for name, path in shared.items() if name not in OF_THE_CLOCK}


def flip(path: Path, out: Path, dice: random.Random) -> None:
    data = bytearray(path.read_bytes())
    data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    path.write_bytes(data)


def truncate(path: Path, out: Path, dice: random.Random) -> None:
    path.write_bytes(path.read_bytes()[: dice.randrange(path.stat().st_size)])


def zero(path: Path, out: Path, dice: random.Random) -> None:
    data = bytearray(path.read_bytes())
    start = dice.randrange(len(data))
    data[start : start + 512] = bytes(len(data[start : start + 512]))
    path.write_bytes(data)


def delete(path: Path, out: Path, dice: random.Random) -> None:
    path.unlink()


def swap(path: Path, out: Path, dice: random.Random) -> None:
    other = dice.choice([one for one in files_of(out) if one != path])
    data = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(data)


def append(path: Path, out: Path, dice: random.Random) -> None:
    with path.open("ab") as file:
        file.write(dice.randbytes(dice.randint(1, 600)))


def empty(path: Path, out: Path, dice: random.Random) -> None:
    path.write_bytes(b"")


def folder(path: Path, out: Path, dice: random.Random) -> None:
    path.unlink()
    path.mkdir()


def fifo(path: Path, out: Path, dice: random.Random) -> None:
    path.unlink()
    os.mkfifo(path)


def link(path: Path, out: Path, dice: random.Random) -> None:
    """A link to the very same bytes elsewhere."""
    elsewhere = out.with_name("elsewhere")
    shutil.copyfile(path, elsewhere)
    path.unlink()
    path.symlink_to(elsewhere)


def loop(path: Path, out: Path, dice: random.Random) -> None:
    path.unlink()
    path.symlink_to(path.name)


def other_content(path: Path, out: Path, dice: random.Random) -> None:
    path.write_bytes(dice.choice([one for one in files_of(out) if one != path]).read_bytes())


def extra(path: Path, out: Path, dice: random.Random) -> None:
    """A good file of ours under a name that nobody gave."""
    shutil.copyfile(path, path.with_name(f"extra-{path.name}"))


STRUCTURAL = [truncate, zero, delete, swap, append, empty, folder, fifo, link, loop, other_content, extra]


@contextlib.contextmanager
def damaged(finished: Path, out: Path, damage: Callable[..., None], dice: random.Random) -> Iterator[Path | None]:
    """Damage one file of a copy, and set it right again; None if the damage changed nothing."""
    path = dice.choice(files_of(out))
    before = {p.relative_to(out): p.read_bytes() for p in files_of(out)}
    damage(path, out, dice)
    now = {p.relative_to(out): p.read_bytes() for p in files_of(out) if not p.is_symlink()}
    try:
        yield None if now == before else path
    finally:
        shutil.rmtree(out)
        shutil.copytree(finished, out, copy_function=shutil.copyfile)


def check_all_are_found(
    finished: Path, out: Path, flips: int, others: int, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished, out, copy_function=shutil.copyfile)
    assert problems_of(out, capsys) == []
    dice = random.Random(seed)
    missed = []
    damages = [flip] * flips + [STRUCTURAL[i % len(STRUCTURAL)] for i in range(others)]
    for number, damage in enumerate(damages):
        with damaged(finished, out, damage, dice) as path:
            if path is not None and not problems_of(out, capsys):
                missed.append((number, damage.__name__, path.relative_to(out).as_posix()))
    assert missed == []
    assert problems_of(out, capsys) == []


def test_damage_is_found_whatever_it_is_and_wherever(finished, tmp_path, capsys):
    check_all_are_found(finished, tmp_path / "out", 24, 24, 1, capsys)


@pytest.mark.slow
def test_1000_flips_and_300_structural_damages_are_found(finished, tmp_path, capsys):
    check_all_are_found(finished, tmp_path / "out", 1000, 300, 2, capsys)


def check_all_are_mended(finished: Path, suite: Path, out: Path, flips: int, others: int, seed: int, capsys) -> None:
    shutil.copytree(finished, out, copy_function=shutil.copyfile)
    whole = content_of(finished)
    dice = random.Random(seed)
    mending = [damage for damage in STRUCTURAL if damage is not extra]
    for damage in [flip] * flips + [mending[i % len(mending)] for i in range(others)]:
        with damaged(finished, out, damage, dice) as path:
            finish(suite, out)
            assert content_of(out) == whole, (damage.__name__, path)
            assert problems_of(out, capsys) == [], (damage.__name__, path)


def test_the_same_command_mends_it(finished, suite, tmp_path, capsys):
    check_all_are_mended(finished, suite, tmp_path / "out", 1, 3, 3, capsys)


@pytest.mark.slow
def test_the_same_command_mends_130_damages(finished, suite, tmp_path, capsys):
    check_all_are_mended(finished, suite, tmp_path / "out", 50, 80, 4, capsys)


@pytest.mark.parametrize("name", ["run.json", "cases/a.json", "state/a.json", "results.parquet"])
def test_what_was_altered_is_told_where_it_is_read_and_said_where_it_is_mended(
    finished, suite, tmp_path, capsys, caplog, name
):
    """A digit that is another one is good JSON, and was taken for the truth."""
    out = tmp_path / "out"
    shutil.copytree(finished, out)
    path = out / name
    data = path.read_bytes()
    place = data.index(b"0.") if b"0." in data else 4
    path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    (problem,) = problems_of(out, capsys)
    assert (problem["problem"], problem["message"]) == ("damaged", f"{name}: altered since the folder was finished")
    if name in ("run.json", "cases/a.json"):
        assert cli.run_command_line(["report", str(out)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{name}: altered since it was written" in line
        assert "run the suite again" in line
    caplog.clear()
    finish(suite, out)
    if name != "results.parquet":
        (line,) = caplog.messages
        assert f"{name}: altered since it was written" in line
        assert "it is made anew" in line
    assert content_of(out) == content_of(finished)
    assert problems_of(out, capsys) == []


def test_a_folder_that_was_cut_off_or_has_no_seals_is_told_in_one_line(finished, suite, tmp_path, capsys):
    out = tmp_path / "out"
    shutil.copytree(finished, out)
    (out / "manifest.json").unlink()
    assert [problem["problem"] for problem in problems_of(out, capsys)] == ["unfinished"]
    for path in out.rglob("*.json"):
        content = json.loads(path.read_text())
        path.write_text(json.dumps({key: value for key, value in content.items() if key != "horizonval:seal"}))
    assert {problem["problem"] for problem in problems_of(out, capsys)} == {"unfinished", "damaged", "index"}
    assert cli.run_command_line(["report", str(out)]) == 2
    assert "has no seal" in capsys.readouterr().err
    finish(suite, out)
    assert content_of(out) == content_of(finished)
    assert problems_of(out, capsys) == []


def test_what_archive_and_report_commands_change_is_no_damage(finished, suite, tmp_path, capsys):
    out, again = tmp_path / "out", tmp_path / "again"
    shutil.copytree(finished, out)
    for arguments in (
        ["archive", "reindex", out],
        ["archive", "gc", out, "--yes"],
        ["archive", "ls", out],
        ["report", out],
        ["archive", "rescore", out, "--out", again, "--workers", "1"],
    ):
        assert cli.run_command_line([str(a) for a in arguments]) == 0
        assert problems_of(out, capsys) == []
    assert problems_of(again, capsys) == []
    (again / "cases" / "a.json").unlink()
    (again / "mine.txt").write_text("")
    assert [problem["problem"] for problem in problems_of(again, capsys)] == ["missing", "foreign"]


class _Full:
    """A disk that takes so many bytes."""

    def __init__(self, room: int) -> None:
        self.room = room

    def flush(self, path: Path) -> None:
        self.room -= path.stat().st_size
        if self.room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


@pytest.mark.parametrize("share", [0.0, 0.4, 0.999])
def test_a_disk_that_fills_up_costs_nothing_but_the_rest(finished, suite, tmp_path, capsys, monkeypatch, share):
    out = tmp_path / "out"
    room = int(share * sum(path.stat().st_size for path in files_of(finished)))
    with monkeypatch.context() as patch:
        patch.setattr(atomic, "flush", _Full(room).flush)
        status = cli.run_command_line(["run", str(suite), "--out", str(out), "--workers", "1"])
    errors = capsys.readouterr().err
    assert status in (1, 2), "a run that ends without its summary is never well"
    assert "No space left on device" in errors
    assert "Traceback" not in errors
    finish(suite, out)
    assert content_of(out) == content_of(finished)
    assert problems_of(out, capsys) == []


class _KilledError(BaseException):
    """Stands for kill -9: nothing below catches it."""


class _Dying:
    """A process that dies as it is about to give its n-th file a name, and leaves what it was writing."""

    def __init__(self, n: int) -> None:
        self.left = n

    def move(self, temporary: Path, path: Path) -> None:
        self.left -= 1
        if self.left < 0:
            if self.left == -1:
                shutil.copyfile(temporary, temporary.with_name(f"{temporary.name[:-4]}-left.tmp"))
            raise _KilledError
        MOVE(temporary, path)


MOVE = atomic.move


def check_deaths(finished: Path, suite: Path, out: Path, moments: list[int], capsys, monkeypatch) -> bool:
    """Let runs into one folder die one after the other, then finish it; True if the last one came to its end."""
    ended = False
    for moment in moments:
        with monkeypatch.context() as patch, contextlib.suppress(_KilledError):
            patch.setattr(atomic, "move", _Dying(moment).move)
            finish(suite, out)
            ended = True
        kinds = {problem["problem"] for problem in problems_of(out, capsys)}
        assert kinds <= {"unfinished", "leftover"}, "nothing is damaged by that"
    finish(suite, out)
    assert content_of(out) == content_of(finished)
    assert problems_of(out, capsys) == []
    return ended


@pytest.mark.parametrize("moments", [[0, 4, 3], [13]])
def test_death_between_any_two_files_changes_nothing(finished, suite, tmp_path, capsys, monkeypatch, moments):
    assert not check_deaths(finished, suite, tmp_path / "out", moments, capsys, monkeypatch)


@pytest.mark.slow
def test_death_at_every_file_changes_nothing(finished, suite, tmp_path, capsys, monkeypatch):
    moment = 0
    while not check_deaths(finished, suite, tmp_path / f"out-{moment}", [moment], capsys, monkeypatch):
        moment += 1
    assert moment > 12
