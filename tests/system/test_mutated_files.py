"""Every file that a user can write, damaged: status 2 and one line for each mistake, in bounded time and memory."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from astropy.io import fits
from mutated_files import COMMANDS, Judged, faults, judge, mutant, write_sound_files

from horizonval.store.export import export_file
from horizonval.store.exr import write_frame, write_image

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and memory of a process as Linux tells them")

SAMPLE, ALL = 3, 110
"""Mutants of each kind of file: some sixty, and 2 000."""


@pytest.fixture
def sound(tmp_path, make_frame, make_image) -> Path:
    """A folder with a sound file of every kind."""
    folder = tmp_path / "sound"
    folder.mkdir()
    write_sound_files(folder)
    rows, columns = np.mgrid[:30, :40]
    grey = np.clip(200.0 / (1.0 + np.exp((np.hypot(columns - 20, rows - 60) - 45) / 0.7)), 1, 250).astype(np.uint8)
    for suffix in ("png", "tiff", "jpg"):
        assert cv2.imwrite(str(folder / f"image.{suffix}"), grey)
    OpenEXR.File({}, {"Y": grey.astype(np.float32)}).write(str(folder / "foreign.exr"))
    fits.CompImageHDU(grey[::-1].astype(np.int32)).writeto(folder / "packed.fits")
    np.save(folder / "image.npy", grey)
    np.savez_compressed(folder / "image.npz", grey)
    np.savetxt(folder / "image.csv", grey, fmt="%d", delimiter=",")
    write_image(folder / "image.exr", make_image())
    write_frame(folder / "frame.exr", make_frame())
    for path in export_file(folder / "image.exr", tmp_path, ["fits", "png"]):
        path.rename(folder / f"exported{path.suffix}")
    return folder


def _judged(sound: Path, each: int) -> list[Judged]:
    judged = list(judge(sound, [(name, number) for name in COMMANDS for number in range(each)]))
    wrong = [entry for entry in judged if entry.fault]
    lines = "\n".join(f"{entry.name} {entry.number}: {entry.fault}" for entry in wrong)
    assert not wrong, f"{len(wrong)} of {len(judged)} mutants:\n{lines}"
    return judged


def test_a_sample_of_mutants_is_refused_in_one_line(sound):
    statuses = Counter(entry.status for entry in _judged(sound, SAMPLE))
    assert statuses.total() == SAMPLE * len(COMMANDS)
    assert statuses[2] > statuses.total() / 2


@pytest.mark.slow
def test_two_thousand_mutants_are_refused_in_one_line(sound):
    assert len(_judged(sound, ALL)) >= 2000


def test_the_same_number_is_the_same_mutant():
    sound = {"scene.toml": b'[scene]\nname = "a"\n', "other": b"x" * 100}
    first = [mutant("scene.toml", number, sound) for number in range(200)]
    assert first == [mutant("scene.toml", number, sound) for number in range(200)]
    assert len(set(first)) > 100


@pytest.mark.parametrize(
    ("status", "errors", "seconds", "memory_mb", "fault"),
    [
        (2, "horizonval: error: a\n", 1.0, 10.0, ""),
        (0, "", 1.0, 10.0, ""),
        (2, "", 1.0, 10.0, "0 lines"),
        (2, "something\n", 1.0, 10.0, "1 lines"),
        (2, "horizonval: error: a\x1b[31m\n", 1.0, 10.0, "control characters"),
        (2, "horizonval: error: " + "a" * 2000, 1.0, 10.0, "characters"),
        (70, "Traceback\n", 1.0, 10.0, "status 70"),
        (2, "horizonval: error: a\n", 11.0, 10.0, "11.0 s"),
        (2, "horizonval: error: a\n", 1.0, 1001.0, "1001 MB"),
    ],
)
def test_the_judge_sees_faults(status, errors, seconds, memory_mb, fault):
    assert fault in faults(status, errors, seconds, memory_mb)
    assert bool(fault) == bool(faults(status, errors, seconds, memory_mb))
