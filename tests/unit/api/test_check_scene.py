"""Every rule finds what it is for and proposes what mends it, for scenes, suites and studies; the cost model."""

from __future__ import annotations

import json
import math
import re

import pytest

from horizonval.api.check import Level, check, check_before_run, check_scene, check_suite
from horizonval.api.check.cost import frame_cost, marched_cells
from horizonval.api.check.frames import Group, look_at, sample_sizes, total_cost
from horizonval.api.check.limb import limb_views
from horizonval.api.check.rules import CODES, RULES
from horizonval.api.scene import Scene
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.earth.atmosphere.air import TOP_M
from horizonval.earth.optical import node_counts, optical_model
from horizonval.renderer.frame import render_frame
from horizonval.scoring.expected import expected_outcome
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import Case, load_scene
from horizonval.store.store import Store
from horizonval.studies.trade.design import expand, read_study
from horizonval.suites.suite import load_suite
from horizonval.truth.frame_truth import truth_of


def changed(name="limb-noon-vis", *, detector=None, sun=None, mount=None, band=None, air=None):
    scene, camera = load_scene(name)
    data = camera.model_dump(mode="json", exclude_unset=True)
    data["detector"] |= detector or {}
    if band is not None:
        data["band"] = [band]
    camera = CameraSpec.model_validate(data)
    if mount is not None:
        scene = scene.model_copy(update={"camera": scene.camera.model_copy(update=mount)})
    if air is not None:
        scene = type(scene).model_validate(scene.model_dump(exclude_unset=True) | {"atmosphere": air})
    if sun is not None:
        scene = type(scene).model_validate(scene.model_dump(exclude_unset=True) | {"sun": sun})
    return scene, camera


def codes(report):
    assert {finding.code for finding in report.findings} <= set(CODES)
    return [finding.code for finding in report.warnings]


def one(report, code):
    (finding,) = (finding for finding in report.findings if finding.code == code)
    return finding


def test_a_good_scene_has_facts_and_cost_and_nothing_wrong():
    report = check_scene(*changed(detector={"exposure_s": 1e-4}))
    assert report.ok
    assert codes(report) == []
    assert "limb at 48 % of full scale" in str(report)
    assert report.cost.frames == 1


def test_a_saturated_limb_and_the_exposure_that_mends_it():
    report = check_scene(*changed(detector={"exposure_s": 4e-3}))
    finding = one(report, "saturated")
    assert finding.level is Level.WARNING
    assert finding.value > finding.limit == 1.0
    number, unit = re.search(r"exposure 4 ms -> (\S+) (us|ms) puts it at (6[89]|7[0-2]) %", finding.fix).group(1, 2)
    assert check_scene(*changed(detector={"exposure_s": float(number) * {"us": 1e-6, "ms": 1e-3}[unit]})).ok
    data = json.loads(report.to_json())
    assert data["ok"] is False
    assert (data["findings"][0]["code"], data["findings"][0]["level"]) == ("saturated", "warning")
    assert data["cost"]["cells"] > 0


def test_too_short_an_exposure_is_dark_and_a_longer_one_is_proposed():
    finding = one(check_scene(*changed(detector={"exposure_s": 1e-7})), "dark")
    assert finding.value < finding.limit == 5.0
    assert re.search(r"exposure 0.1 us -> 1\d\d us", finding.fix)


def test_a_thermal_limb_beyond_the_converters_end():
    report = check_scene(*changed("limb-night-ir", detector={"scene_max_k": 240.0}))
    finding = one(report, "saturated")
    assert finding.value > 1.0
    kelvin = float(re.search(r"scene_max_k above (\d+) K", finding.fix).group(1))
    mended = check_scene(*changed("limb-night-ir", detector={"scene_max_k": kelvin + 20.0}))
    assert "saturated" not in codes(mended)


def test_rays_that_miss_the_limbs_place_in_wide_thermal_pixels_are_noted():
    """A pixel on the axis of 160 px in 60 deg at the horizon from 500 km, 2573 km away, is 18.6 km wide, to 1 %."""
    scene, camera = changed("limb-night-ir")
    camera = camera.model_copy(
        update={"camera": camera.camera.model_copy(update={"width": 160, "height": 128, "fov_deg": 60.0})}
    )

    def noted(subsamples):
        render = scene.render.model_copy(update={"subsamples": subsamples})
        platform = scene.platform.model_copy(update={"altitude_km": 500.0})
        found = check_scene(scene.model_copy(update={"render": render, "platform": platform}), camera).findings
        return [finding for finding in found if finding.code == "coarse-rays"]

    (coarse,) = noted(2)
    assert coarse.level is Level.NOTE
    assert coarse.value == pytest.approx(2573.0 * 2.0 * math.tan(math.radians(30.0)) / 160.0 / 2.0, rel=0.02)
    assert "render.subsamples" in coarse.fix
    assert noted(4) == []


@pytest.mark.parametrize("zenith_deg", [120.0, 132.7, 145.5, 160.1, 171.3, 180.0])
def test_everywhere_deep_behind_the_earth_is_eclipse(zenith_deg):
    scene, camera = changed(sun={"zenith_deg": zenith_deg, "azimuth_deg": 40.0})
    for latitude_deg in (-71.3, -20.0, 5.5, 33.3):
        platform = scene.platform.model_copy(update={"latitude_deg": latitude_deg, "altitude_km": 550.0})
        view = limb_views(truth_of(scene.model_copy(update={"platform": platform}), camera), camera)[0]
        assert view.sun_outside_deg is None
        assert not view.expected.sun_in_frame
        assert [rule.code for rule in RULES if rule.find(view) is not None][:1] == ["eclipse"]


def test_eclipse_no_limb_and_short_arc():
    assert codes(check("night")) == ["eclipse"]
    assert codes(check_scene(*changed(mount={"mount_roll_deg": 10.0}))) == ["no-limb"]
    scene, camera = load_scene("ir-limb-tropical")
    strict = type(scene).model_validate(scene.model_dump(exclude_unset=True) | {"prior": {"accept_deg": 0.05}})
    bands = [finding for finding in check_scene(strict, camera).warnings if finding.code == "short-arc"]
    assert [finding.subject for finding in bands] == ["co2", "co2-narrow", "lwir", "window"]
    assert all("deg, 0.05 deg are needed" in finding.text for finding in bands)
    assert all(finding.value > finding.limit for finding in bands)


def test_the_sun_in_the_frame_and_near_it():
    inside = near_ones = 0
    for zenith in range(50, 110, 3):
        report = check_scene(*changed(sun={"zenith_deg": float(zenith), "azimuth_deg": 280.0}))
        found = {finding.code for finding in report.findings}
        inside += "sun-in-frame" in found
        if "sun-near" in found:
            near_ones += 1
            near = one(report, "sun-near")
            assert 0.0 < near.value < near.limit
            assert "sun-in-frame" not in found
    assert inside
    assert near_ones


def test_a_band_outside_the_tables_is_an_error_not_a_traceback():
    report = check_scene(*changed(band={"name": "uv", "kind": "solar", "lo_um": 0.2, "hi_um": 0.3}))
    finding = one(report, "cannot-run")
    assert finding.level is Level.ERROR
    assert "'uv'" in finding.text
    assert report.cost is None


def test_all_heads_of_a_camera_are_checked():
    suite = load_suite("cameras")
    case = next(case for case in suite.cases if len(case.camera.head) > 1)
    whole = case.scene.model_copy(update={"camera": case.scene.camera.model_copy(update={"head": "all"})})
    report = check_scene(whole, case.camera)
    assert report.frames == len(case.camera.head)
    assert len(report.facts) == len(case.camera.head) * len(case.camera.band)


def test_a_suite_says_what_its_score_will_say():
    suite = load_suite("quick")
    report = check_suite(suite, infrared=False)
    outcomes = [expected_outcome(truth_of(c.scene, c.camera, infrared=False)).outcome for c in suite.cases]
    for code, outcome in {"saturated": "saturated", "short-arc": "short_arc", "no-limb": "no_limb"}.items():
        found = sum(finding.frames for finding in report.findings if finding.code == code)
        assert found == sum(str(one) == outcome for one in outcomes) > 0
    # A suite of 44 frames may have a few that are meant to be hopeless: notes, not warnings.
    assert report.ok
    assert report.examined == report.frames == 44


def test_the_default_suite_shows_a_sensor_at_work():
    """Most of its frames are usable, some must be refused, and few are borderline, where nothing counts."""
    cases = load_suite("quick").cases
    expected = [expected_outcome(truth_of(case.scene, case.camera, infrared=False)) for case in cases]
    clear = [frame.outcome for frame in expected if not frame.borderline]
    assert len(cases) - len(clear) <= 0.2 * len(cases)
    assert clear.count(Outcome.VALID) >= 0.5 * len(cases)
    assert {Outcome.DARK, Outcome.SATURATED, Outcome.SHORT_ARC, Outcome.NO_LIMB} <= set(clear)
    assert any(frame.sun_in_frame for frame in expected)


def test_of_many_frames_a_stated_sample_is_looked_at():
    report = check_suite(load_suite("quick"), most=6, infrared=False)
    assert (report.examined, report.frames) == (6, 44)
    assert "looked at 6 of 44 frames" in str(report)
    assert any(finding.total > finding.of and "looked at" in finding.line() for finding in report.findings)
    # The cost is that of all frames, from those of the sample.
    whole = check_suite(load_suite("quick"), infrared=False).cost
    assert report.cost.frames == whole.frames
    assert report.cost.processor_s == pytest.approx(whole.processor_s, rel=0.3)


@pytest.mark.parametrize("counts", [[3, 100, 2], [1] * 50, [400], [10, 10]])
def test_samples_are_shared_fairly(counts):
    sizes = sample_sizes(counts, 32)
    assert sum(sizes) == min(sum(counts), 32)
    assert all(size <= count for size, count in zip(sizes, counts, strict=True))
    if len(counts) <= 32:
        assert min(sizes) >= 1


def test_a_suite_that_a_run_would_refuse(tmp_path):
    path = tmp_path / "suite.toml"
    path.write_text(
        '[suite]\nname = "s"\nestimators = ["no-such"]\n[[frame]]\nscene.name = "a"\n'
        'camera.file = "vis-cmos-512-60deg"\nplatform.altitude_km = 500.0\n'
    )
    report = check(path)
    assert [finding.level for finding in report.findings] == [Level.ERROR]
    assert "no-such" in str(report)


def test_wrong_use():
    with pytest.raises(UserError, match="no scene, suite or study named 'limb-noon'"):
        check("limb-noon")
    for target in ("limb-noon-vis", Scene.from_file("limb-noon-vis")):
        with pytest.raises(UserError, match="a scene is one frame"):
            check(target, frames=3)


STUDY = """
[study]
name = "all-saturated"
seed = 1
estimators = ["altitude-free"]

[defaults]
camera = {{ file = "vis-cmos-512-60deg", mount_roll_deg = 65.0, detector = {{ exposure_s = {exposure_s} }} }}
platform = {{ epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }}

[design.grid]
"camera.camera.fov_deg" = [60.0, 90.0]
"camera.optics.f_number" = [2.8, 4.0]
"camera.camera.width" = [256, 512]

[frames.grid]
"platform.latitude_deg" = [-20.0, 0.0, 20.0]
"platform.heading_deg" = [0.0, 10.0]
"""


@pytest.fixture
def load(tmp_path):
    def build(exposure_s):
        path = tmp_path / "study.toml"
        path.write_text(STUDY.format(exposure_s=exposure_s))
        return path, expand(*read_study(path))

    return build


def test_eight_designs_whose_48_frames_are_all_saturated(load):
    path, study = load(1e-3)
    report = check(path)
    assert (len(study.designs), report.examined, report.frames) == (8, 48, 48)
    assert not report.ok
    saturated = [finding for finding in report.findings if finding.code == "saturated"]
    assert {finding.subject for finding in saturated} == {design.frames for design in study.designs}
    for finding in saturated:
        assert finding.level is Level.WARNING
        assert (finding.frames, finding.of) == (6, 6)
        assert finding.value > finding.limit == 1.0
        assert "saturated" in finding.text
        assert "exposure 1 ms -> " in finding.fix
    # The engine's own words come first: a few lines in all, one of them about all designs together.
    lines = check_before_run(study).summary_lines()
    assert len(lines) == 2
    assert "8 designs: all 32 frames looked at: " in lines[0]
    assert "saturated" in lines[0]
    assert lines[1].startswith("looked at 32 of 48 frames")


def test_the_proposed_exposure_mends_it(load):
    _, study = load(1e-3)
    worst = max((f for f in check_suite(study).findings if f.code == "saturated"), key=lambda f: f.value)
    number, unit = worst.fix.split(" -> ")[1].split(" puts")[0].split()
    _, mended = load(float(number) * {"ms": 1e-3, "us": 1e-6}[unit])
    report = check_suite(mended)
    assert report.ok
    assert "saturated" not in {finding.code for finding in report.findings}
    assert check_before_run(mended).summary_lines() == []


def loaded(name, **changes):
    scene, camera = load_scene(name)
    scene = scene.model_copy(update={"render": scene.render.model_copy(update=changes)})
    return scene, camera


@pytest.mark.parametrize("name", ["limb-noon-vis", "sun-behind-limb"])
def test_cells_are_those_whose_rays_meet_the_air(name):
    """By the rendered frame's own map of tangent heights. Within a fiftieth of the image: the grid on which cells are
    counted has 48 lines a side."""
    scene, camera = loaded(name, subsamples=1, nodes=8, orders="single")
    frame = render_frame(scene, camera)
    marched = (frame.maps["tangent_height"] < TOP_M).sum()
    pixels = camera.camera.width * camera.camera.height
    assert marched_cells(frame.truth, camera, 1) == pytest.approx(marched, abs=pixels / 50)
    assert 0.1 * pixels < marched < pixels


def test_time_goes_with_cells_nodes_and_bands():
    scene, camera = loaded("limb-noon-vis")
    truth = truth_of(scene, camera)
    spectral = node_counts(optical_model(scene, camera))
    whole = frame_cost(truth, scene, camera, spectral, 1)
    assert whole.evaluations == pytest.approx(whole.cells * scene.render.nodes * spectral["vis"])
    half, _ = loaded("limb-noon-vis", nodes=scene.render.nodes // 2)
    assert frame_cost(truth, half, camera, spectral, 1).evaluations == pytest.approx(whole.evaluations / 2)
    fine, _ = loaded("limb-noon-vis", subsamples=4)
    assert frame_cost(truth, fine, camera, spectral, 1).cells == pytest.approx(4 * whole.cells)
    single, _ = loaded("limb-noon-vis", orders="single")
    assert frame_cost(truth, single, camera, spectral, 1).tables == 0 < whole.tables


def test_disk_is_that_of_the_archive(tmp_path):
    """Of a rendered frame within 1.5: what compression leaves hangs on what is in the picture."""
    scene, camera = loaded("limb-noon-vis", subsamples=1, nodes=16, orders="single")
    frame = render_frame(scene, camera)
    store = Store(tmp_path)
    stored = [store.path(store.add_frame(frame)), store.path(store.add_image(observe(frame, camera)))]
    cost = frame_cost(frame.truth, scene, camera, {"vis": 4}, 1)
    predicted = cost.frame_bytes + cost.image_bytes
    assert 1 / 1.5 < predicted / sum(path.stat().st_size for path in stored) < 1.5


@pytest.mark.parametrize(("method", "tables"), [("table", True), ("march", False)])
def test_frames_from_one_place_share_its_view_tables(method, tables):
    """Turned cameras cost the tables once, and each its own looks; without tables every frame costs its march."""
    scene, camera = loaded("limb-noon-vis", method=method)

    def total(*rolls_deg):
        attitudes = [scene.attitude.model_copy(update={"roll_deg": roll}) for roll in rolls_deg]
        group = Group("camera", tuple(Case(scene.model_copy(update={"attitude": a}), camera) for a in attitudes))
        return total_cost([group], [look_at(group, 9, {}, infrared=False)], "none").render_s

    alone, both = total(scene.attitude.roll_deg), total(scene.attitude.roll_deg, scene.attitude.roll_deg + 1e-6)
    cost = frame_cost(truth_of(scene, camera), scene, camera, node_counts(optical_model(scene, camera)), 1)
    assert alone == pytest.approx(cost.render_s + cost.view_tables_s, rel=1e-3)
    assert both == pytest.approx(2 * cost.render_s + cost.view_tables_s, rel=1e-3)
    assert bool(cost.view_tables_s) == tables
