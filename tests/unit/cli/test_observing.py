"""What the options of `observe` mean: lists, ranges, names of files, and what is refused."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
from synthetic import CMOS

from horizonval.cli.images import plans
from horizonval.core.errors import UserError
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_camera

CAMERA: dict[str, Any] = {
    "camera": {"name": "small", "width": 40, "height": 30, "fov_deg": 60.0},
    "band": [
        {"name": "red", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7},
        {"name": "blue", "kind": "solar", "lo_um": 0.4, "hi_um": 0.5},
    ],
    "detector": CMOS,
}
SPEC = CameraSpec.model_validate(CAMERA)


def names(out: str, seeds: list[str], exposures: list[str], bands: list[str]) -> list[str]:
    return [plan.path.as_posix() for plan in plans(out, seeds, exposures, bands, SPEC)]


def test_one_image_by_default() -> None:
    (plan,) = plans("image.exr", [], [], [], SPEC)
    assert (plan.path, plan.seed, plan.exposure_s, plan.band) == (Path("image.exr"), 0, None, None)
    assert plan.camera(SPEC) is SPEC


@pytest.mark.parametrize(
    ("given", "meant"),
    [(["7"], [7]), (["0-3"], [0, 1, 2, 3]), (["3", "4"], [3, 4]), (["5,1-2"], [5, 1, 2]), (["1,1", "1"], [1])],
)
def test_seeds(given: list[str], meant: list[int]) -> None:
    assert [plan.seed for plan in plans("{seed}.exr", given, [], [], SPEC)] == meant


def test_every_combination_has_its_own_name() -> None:
    found = names("i-{band}-{exposure}-{seed:02d}.exr", ["0-1"], ["1e-3,2e-3"], ["red", "blue"])
    assert len(found) == len(set(found)) == 8
    assert found[0] == "i-red-0.001-00.exr"
    assert found[-1] == "i-blue-0.002-01.exr"
    # What does not differ may stand in the name too: the camera file's exposure and first band.
    assert names("{band}-{exposure}-{seed}.exr", ["5"], [], []) == ["red-0.0002-5.exr"]


def test_a_folder_names_its_files_after_what_differs(tmp_path: Path) -> None:
    assert names("out/", ["0-1"], [], []) == ["out/0.exr", "out/1.exr"]
    assert names("out", ["3"], ["1e-3,2e-3"], []) == ["out/0.001.exr", "out/0.002.exr"]
    folder = tmp_path / "a.b"
    folder.mkdir()
    assert names(str(folder), ["0-1"], [], ["red,blue"])[0] == (folder / "red-0.exr").as_posix()


def test_an_exposure_takes_the_place_of_the_automatic_one() -> None:
    tables: dict[str, Any] = copy.deepcopy(CAMERA)
    tables["detector"]["auto_exposure"] = {"min_s": 1e-5, "max_s": 1e-2}
    spec = CameraSpec.model_validate(tables)
    (plan,) = plans("image.exr", [], ["3e-3"], [], spec)
    detector: Any = plan.camera(spec).detector
    assert (detector.exposure_s, detector.auto_exposure) == (3e-3, None)
    assert plans("image.exr", [], [], [], spec)[0].camera(spec) is spec


@pytest.mark.parametrize(
    ("out", "seeds", "exposures", "parts"),
    [
        ("i.exr", ["0-9"], [], ["10 images would overwrite each other", "{seed}", "a folder"]),
        ("i-{seed}.exr", ["0-1"], ["1,2"], ["4 images", "{exposure}"]),
        ("i-{time}.exr", [], [], ["found 'i-{time}.exr'", "{seed}"]),
        ("i-{seed", ["0-1"], [], ["found 'i-{seed'"]),
        ("i-{exposure:.4}.exr", [], ["0.001,0.002"], ["2 images would overwrite each other"]),
        ("{seed}.exr", ["-1"], [], ["found '-1'", "from 0 up"]),
        ("{seed}.exr", ["4-2"], [], ["found '4-2'"]),
        ("{seed}.exr", ["0-99999"], [], ["too many", "10000"]),
        ("{seed}-{exposure}.exr", ["0-999"], [",".join(map(str, range(1, 12)))], ["11000 images"]),
        ("i.exr", [], ["0"], ["found '0'", "seconds above 0"]),
        ("i.exr", [], ["fast"], ["found 'fast'"]),
        ("i.exr", [], ["inf"], ["found 'inf'"]),
        ("out", ["0-9999", "10000-19999"], [], ["20000 images"]),
        ("out", ["9" * 5000], [], ["numbers from 0 up"]),
        ("out", [], ["9" * 5000], ["at most"]),
    ],
)
def test_refused(out: str, seeds: list[str], exposures: list[str], parts: list[str]) -> None:
    with pytest.raises(UserError) as refusal:
        plans(out, seeds, exposures, [], SPEC)
    line = refusal.value.line()
    assert "\n" not in line
    for part in parts:
        assert part in line


def test_no_exposure_in_the_infrared() -> None:
    with pytest.raises(UserError, match=r"--exposure: .*'microbolometer'.* no exposure"):
        plans("i.exr", [], ["1e-3"], [], load_camera("ir-bolometer-160-57deg"))
