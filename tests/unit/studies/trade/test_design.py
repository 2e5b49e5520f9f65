"""Study files become designs and frames: names, common conditions and draws, mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.studies.trade.design import expand, read_study
from horizonval.suites import observation
from horizonval.suites.identity import unit_identity
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import plan_of, units_of
from horizonval.truth.frame_truth import truth_of

STUDIES = sorted((Path(__file__).parents[4] / "scenes" / "studies").glob("*.toml"))

STUDY = """
[study]
name = "s"
seed = 3
estimators = ["altitude-free", "ideal"]
[defaults]
camera = { file = "vis-cmos-512-60deg", mount_roll_deg = 65.0, camera = { width = 48, height = 48 } }
platform.altitude_km = 500.0
[design.grid]
"camera.optics.psf_sigma_px" = [0.5, 1.0]
[frames.sobol]
n = 3
ranges = { "platform.latitude_deg" = [-20.0, 20.0] }
"""


@pytest.fixture
def load(tmp_path):
    def build(text: str, frames=None):
        (tmp_path / "s.toml").write_text(text)
        return expand(*read_study(tmp_path / "s.toml", frames))

    return build


def identities(study):
    plan = plan_of(study.suite)
    return {unit.name: unit_identity(unit, plan) for unit in units_of(study.suite.cases, plan)}


def test_designs_and_frames(load):
    study = load(STUDY)
    assert [design.name for design in study.designs] == [
        f"psf_sigma_px_{psf}_{estimator}" for psf in ("0.5", "1") for estimator in ("altitude-free", "ideal")
    ]
    assert study.designs[2].settings == {"camera.optics.psf_sigma_px": 1.0, "estimator": "altitude-free"}
    assert [case.name for case in study.suite.cases][:4] == [
        "psf_sigma_px_0.5__000", "psf_sigma_px_0.5__001", "psf_sigma_px_0.5__002", "psf_sigma_px_1__000",
    ]  # fmt: skip
    assert study.frames["psf_sigma_px_1__000"] == ("psf_sigma_px_1", "000")
    assert {case.camera.optics.psf_sigma_px for case in study.suite.cases} == {0.5, 1.0}


def test_what_is_known_is_an_axis_and_its_errors_are_common(load):
    """The same luck for every design: an error is the sigma times the condition's own numbers."""
    grid = '"camera.optics.psf_sigma_px" = [0.5, 1.0]'
    study = load(STUDY.replace(grid, '"prior.position_sigma_km" = [1.0, 10.0]'))
    assert study.designs[0].settings == {"prior.position_sigma_km": 1.0, "estimator": "altitude-free"}
    refuse_mistakes(study.suite, plan_of(study.suite))
    errors = {}
    for case in study.suite.cases:
        truth = truth_of(case.scene, case.camera)
        errors[case.name] = observation.known_of(truth, "vis").r_itrs - np.array(truth.r_itrs)
    for condition in ("000", "001", "002"):
        near, far = (errors[f"position_sigma_km_{sigma}__{condition}"] for sigma in (1, 10))
        # A micrometre of 7000 km is rounding.
        assert far == pytest.approx(10.0 * near, abs=1e-5)
    assert not np.allclose(errors["position_sigma_km_1__000"], errors["position_sigma_km_1__001"], atol=1.0)


def test_a_limb_height_of_a_solar_band_cannot_be_drawn(load):
    known = "[defaults.prior]\nlimb_height_sigma_km = 1.0\n[design.grid]"
    suite = load(STUDY.replace("[design.grid]", known)).suite
    with pytest.raises(UserError, match="limb_height_km beside it"):
        refuse_mistakes(suite, plan_of(suite))


def test_every_design_meets_the_same_conditions_and_draws(load):
    cases = load(STUDY).suite.cases
    for a, b in zip(cases[:3], cases[3:], strict=True):
        assert a.scene.platform == b.scene.platform
        assert a.scene.scene.draw == b.scene.scene.draw
        assert a.scene.scene.name != b.scene.scene.name
    assert len({case.scene.scene.draw for case in cases}) == 3
    assert len({case.scene.platform.latitude_deg for case in cases}) == 3


def test_new_values_leave_the_old_frames_as_they_are(load):
    before = identities(load(STUDY))
    wider = identities(load(STUDY.replace("[0.5, 1.0]", "[0.25, 0.5, 1.0]")))
    more = identities(load(STUDY, frames=5))
    assert before.items() < wider.items()
    assert before.items() < more.items()
    assert (len(before), len(wider), len(more)) == (6, 9, 10)


def test_choices_and_lists_are_axes(load):
    text = STUDY.replace(
        "[frames.sobol]",
        """[design.choices]
sensor = [
  { name = "small", camera.camera = { width = 32, height = 24 } },
  { name = "large", camera.camera = { width = 64, height = 48 }, estimators = ["ideal"] },
]
[frames.sobol]""",
    )
    study = load(text)
    assert [design.name for design in study.designs] == [
        "small_psf_sigma_px_0.5_altitude-free", "small_psf_sigma_px_0.5_ideal",
        "small_psf_sigma_px_1_altitude-free", "small_psf_sigma_px_1_ideal",
        "large_psf_sigma_px_0.5_ideal", "large_psf_sigma_px_1_ideal",
    ]  # fmt: skip
    assert (study.designs[0].width, study.designs[0].height) == (32, 24)
    assert study.designs[-1].settings["sensor"] == "large"


ORBIT = """orbit = { epoch_utc = 2026-03-20T00:00:00Z, altitude_km = 500.0, sun_synchronous = true, n = 4 }"""
SEASONS = STUDY.replace(
    '[frames.sobol]\nn = 3\nranges = { "platform.latitude_deg" = [-20.0, 20.0] }',
    f'[frames]\n{ORBIT}\nsobol = {{ n = 3, ranges = {{ "orbit.ltan_h" = [6.0, 12.0] }} }}',
).replace(
    '"camera.optics.psf_sigma_px" = [0.5, 1.0]', '"orbit.epoch_utc" = [2026-03-20T00:00:00Z, 2026-06-21T00:00:00Z]'
)


def test_the_season_is_an_axis_and_flights_are_clusters(load):
    study = load(SEASONS)
    assert {case.scene.platform.epoch_utc.month for case in study.suite.cases} == {3, 6}
    assert study.designs[0].settings["orbit.epoch_utc"] == "2026-03-20T00:00:00+00:00"
    assert study.conditions["001_003"] == "001"
    assert sorted(set(study.conditions.values())) == ["000", "001", "002"]


def test_heads_are_one_camera(load):
    text = STUDY.replace("vis-cmos-512-60deg", "vis-pair-1024-60deg").replace(
        '["altitude-free", "ideal"]', '["video-vertical"]'
    )
    study = load(text)
    refuse_mistakes(study.suite, plan_of(study.suite))
    assert (study.designs[0].heads, study.designs[0].name) == (2, "psf_sigma_px_0.5")
    assert study.frames["psf_sigma_px_0.5__000"] == ("psf_sigma_px_0.5", "000")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (("psf_sigma_px", "psf_sgima_px"), ["design psf_sgima_px_0.5, frames", "optics.psf_sgima_px: unknown"]),
        (("platform.latitude_deg", "camera.optics.psf_sigma_px"), [": design:", "varied by [frames] too"]),
        (('"camera.optics.psf_sigma_px"', '"orbit.altitude_km"'), ["a design changes the orbit", "frames.orbit"]),
        (('"camera.optics.psf_sigma_px"', '"estimator"'), ["design.grid.estimator", "study.estimators"]),
        (
            ("[defaults]", '[[requirement]]\nid = "R1"\nerror_deg = 1.0\navailability = 99.0\n[defaults]'),
            ["requirement[1].availability", "99.0"],
        ),
        (("[defaults]", '[[requirement]]\nid = "R1"\navailability = 0.9\n[defaults]'), ["needs error_deg"]),
        (("seed = 3", "cheapest_by = \"mass\""), ["study.cheapest_by", "'mass' is no column", "pixel_rate"]),
        (("[design.grid]", "[design]\ncost = { pixels = 1.0 }\n[design.grid]"), ["a cost is named 'pixels'"]),
        (
            ("[design.grid]", "[design]\nlist = [{ name = \"a\", cost.mass_g = 1 }, { name = \"b\" }]\n[design.grid]"),
            ["list[2].cost has no mass_g"],
        ),
        (("[design.grid]", "[design]\nlist = [{ scene.seed = 1 }]\n[design.grid]"), ["list[1] has no name"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(load, change, parts):
    assert STUDY.count(change[0]) >= 1
    with pytest.raises(UserError) as e:
        load(STUDY.replace(*change))
    line = e.value.line()
    assert "\n" not in line
    assert "s.toml" in line
    assert all(part in line for part in parts), line


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_shipped_studies_load_and_check(path):
    study = expand(*read_study(path, 2))
    refuse_mistakes(study.suite, plan_of(study.suite))
    assert study.suite.name == path.stem


def test_the_full_study_has_48_cameras_with_three_methods_and_16_pairs_with_one():
    study = expand(*read_study("altitude-free-optics", 2))
    assert [sum(design.heads == heads for design in study.designs) for heads in (1, 2)] == [48 * 3, 16]
