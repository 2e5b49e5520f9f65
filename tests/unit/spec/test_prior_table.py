"""The table ``[prior]``: as a file, in scenes, as an axis of suites; and one line for every mistake."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from horizonval.api.estimate import prior_from
from horizonval.core.errors import UserError
from horizonval.estimation.fit import templates
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import shipped_path
from horizonval.spec.load import Case, Suite, load_prior, load_scene, load_suite
from horizonval.spec.prior import PriorSpec
from horizonval.spec.scene import SceneSpec
from horizonval.suites.identity import frame_identity
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import plan_of
from horizonval.truth.frame_truth import truth_of

WHOLE = """[prior]
shape = "sphere"
radius_km = 6378.0
altitude_km = 550.0
altitude_sigma_km = 1
position_itrs_km = [6928.0, 0, 0.5]
position_sigma_km = 1.0
q_cam_from_itrs = [0.7071, 0.0, 0.0, 0.7071]
attitude_sigma_deg = [1.0, 1, 2.0]
epoch_utc = 2026-03-20T12:00:00Z
limb_height_km = -1.5
limb_height_sigma_km = 0.3
climate = "by_latitude_month"
sun_sigma_deg = 0.5
limb_scale_height_km = 0
limb_scale_height_sigma_km = 0.0
limb_relief_km = 0.0
air_height_sigma_km = 0.1
lens_blur_px = 0.5
gain_sigma_percent = 3.0
accept_deg = 1.0
"""

SCENE = """[camera]
file = "vis-cmos-512-60deg"
[platform]
altitude_km = 500.0
"""


def _file(folder: Path, text: str, name: str = "p.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_whole_file_is_read(tmp_path: Path) -> None:
    spec = load_prior(_file(tmp_path, WHOLE))
    assert spec.position_itrs_km == (6928.0, 0.0, 0.5)
    assert spec.epoch_utc == datetime(2026, 3, 20, 12, tzinfo=UTC)
    # What is kept with a frame as JSON reads back.
    assert PriorSpec.model_validate(json.loads(spec.model_dump_json())) == spec
    with pytest.raises(UserError, match=r"none\.toml"):
        load_prior(tmp_path / "none.toml")


def test_a_climates_file_lies_beside_the_file_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "air").mkdir()
    (tmp_path / "air" / "mine.csv").write_text("x")
    path = _file(tmp_path, '[prior]\nclimate = "air/mine.csv"\n')
    assert load_prior(path).climate == str((tmp_path / "air" / "mine.csv").resolve())
    scene, _ = load_scene(_file(tmp_path, SCENE + '[prior]\nclimate = "air/mine.csv"\n', "s.toml"))
    assert scene.prior.climate == str((tmp_path / "air" / "mine.csv").resolve())


def _suite_with(folder: Path, table: str, camera: str = "ir-bolometer-160-57deg") -> Suite:
    text = f'[suite]\nname = "s"\nestimators = ["limb-profile"]\n[defaults]\ncamera.file = "{camera}"\n'
    text += f'platform.altitude_km = 500.0\nprior.climate = "{table}"\n[[frame]]\nscene.name = "a"\n'
    return load_suite(_file(folder, text, "suite.toml"))


def test_a_table_of_profiles_is_read_before_anything_is_rendered(tmp_path: Path) -> None:
    """A whole one passes; one that is missing, damaged or of another band is one line that names it."""
    shipped = templates.FOLDER / "limb-lwir.npz"
    (tmp_path / "whole.npz").write_bytes(shipped.read_bytes())
    (tmp_path / "cut.npz").write_bytes(shipped.read_bytes()[:5000])
    suite = _suite_with(tmp_path, "whole.npz")
    refuse_mistakes(suite, plan_of(suite))
    with pytest.raises(UserError, match=r"prior\.climate: .*none\.npz.*expected a profile") as none:
        _suite_with(tmp_path, "none.npz")
    suite = _suite_with(tmp_path, "cut.npz")
    with pytest.raises(UserError, match=r"cut\.npz: not a table, or damaged") as cut:
        refuse_mistakes(suite, plan_of(suite))
    suite = _suite_with(tmp_path, "whole.npz", "vis-cmos-512-60deg")
    with pytest.raises(UserError, match=r"whole\.npz: a thermal table of 8 to 14 um, .* expected vis \(") as other:
        refuse_mistakes(suite, plan_of(suite))
    assert all("\n" not in found.value.line() for found in (none, cut, other))
    with pytest.raises(UserError, match=r"p\.toml: .*cut\.npz: not a table, or damaged"):
        prior_from(_file(tmp_path, '[prior]\nclimate = "cut.npz"\n'))
    assert prior_from(_file(tmp_path, '[prior]\nclimate = "whole.npz"\n')).climate == str(tmp_path / "whole.npz")


def test_a_climates_file_counts_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("x")
    text = '[suite]\nname = "s"\nestimators = ["ideal"]\n[defaults]\ncamera.file = "vis-cmos-512-60deg"\n'
    text += 'platform.altitude_km = 500.0\nprior.climate = "mine.csv"\n[[frame]]\nscene.name = "a"\n'
    suite = load_suite(_file(tmp_path, text))
    before = frame_identity(suite.cases[0])
    (tmp_path / "mine.csv").write_text("y")
    assert frame_identity(suite.cases[0]) != before


def test_who_knows_more_sees_the_same_noise(tmp_path: Path) -> None:
    """The identity of a scene without the table is that of before there was one."""
    camera = CameraSpec.model_validate({"camera": {"width": 8, "height": 8, "fov_deg": 40.0}})
    plain = {"camera": {"file": "x"}, "platform": {"altitude_km": 500.0}}
    scenes = [
        SceneSpec.model_validate(plain),
        SceneSpec.model_validate(plain | {"prior": {"altitude_sigma_km": 1.0}}),
        SceneSpec.model_validate(plain | {"prior": {"position_sigma_km": 10.0}}),
    ]
    truths = [truth_of(scene, camera) for scene in scenes]
    assert len({truth.scene_id for truth in truths}) == 1
    assert "prior" not in truths[0].scene
    assert truths[1].scene["prior"]["altitude_sigma_km"] == 1.0


def test_a_scene_keeps_its_identity_unless_it_is_marched() -> None:
    camera = CameraSpec.model_validate({"camera": {"width": 8, "height": 8, "fov_deg": 40.0}})
    plain = {"camera": {"file": "x"}, "platform": {"altitude_km": 500.0}}
    silent, table, march = (
        Case(SceneSpec.model_validate(plain | {"render": keys}), camera)
        for keys in ({}, {"method": "table"}, {"method": "march"})
    )
    assert "method" not in silent.scene.model_dump()["render"]
    for identity in (frame_identity, lambda case: truth_of(case.scene, case.camera).scene_id):
        assert identity(silent) == identity(table)
        assert identity(march) != identity(table)


def test_a_sigma_is_an_axis_of_a_suite(tmp_path: Path) -> None:
    text = f"""[suite]
name = "s"
estimators = ["altitude-free"]
[defaults]
camera.file = "{shipped_path("camera", "vis-cmos-512-60deg")}"
platform.altitude_km = 500.0
[[cases]]
name = "known"
grid = {{ prior.position_sigma_km = [0.1, 1.0, 10.0] }}
"""
    suite = load_suite(_file(tmp_path, text))
    assert [case.scene.prior.position_sigma_km for case in suite.cases if case.scene.prior] == [0.1, 1.0, 10.0]
    assert suite.cases[0].name == "known_position_sigma_km_0.1"
