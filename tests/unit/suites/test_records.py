"""Records and rows of a suite, and the items of a rescoring."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from synthetic import THERMAL_CAMERA, estimator, result_row, toy_image, truth_at

from horizonval.core.errors import UserError
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.frame import RadianceFrame
from horizonval.geometry.ellipsoid import sphere
from horizonval.jobs.engine import take_over
from horizonval.jobs.pool import local_workers, parse_shard
from horizonval.plugins import registry
from horizonval.store.entry import StoreEntry
from horizonval.store.store import Store
from horizonval.suites.identity import rescored_identity, suite_identity
from horizonval.suites.observation import method_radius_m, observation_of, observation_of_heads, oracle_pose
from horizonval.suites.plan import CasePlan, plan_of
from horizonval.suites.record import (
    camera_name,
    failed_record,
    figure_plans,
    record_of,
    value_at,
)
from horizonval.suites.suite import load_suite
from horizonval.suites.units.archived import Item, cases_of_heads, climates_of, items_of

SUITE = """
[suite]
name = "s"
title = "Some"
estimators = ["altitude-free", "ideal"]
[defaults]
camera = { file = "vis-cmos-512-60deg", mount_roll_deg = 55.0 }
platform.altitude_km = 500.0
[[cases]]
name = "near"
grid = { attitude.yaw_deg = [5.0, 6.0], sun.zenith_deg = [10.0, 20.0] }
[[cases]]
name = "far"
grid = { platform.altitude_km = [900.0] }
[[figure]]
kind = "sweep"
cases = "near"
x = "attitude.yaw_deg"
by = "sun.zenith_deg"
[[figure]]
kind = "map"
x = "platform.altitude_km"
y = "camera.detector.exposure_s"
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("suite") / "s.toml"
    path.write_text(SUITE)
    return load_suite(path)


def test_a_figure_stands_on_its_axes(suite) -> None:  # type: ignore[no-untyped-def]
    first, second, all_of_them = figure_plans(suite)
    assert [first["title"], second["title"]] == ["near, sun.zenith_deg 10", "near, sun.zenith_deg 20"]
    assert sorted(first["cases"].values()) == [[5.0], [6.0]]
    assert not set(first["cases"]) & set(second["cases"])
    assert all_of_them["title"] == "Some"
    assert len(all_of_them["cases"]) == 5
    exposure = suite.cases[0].camera.detector.exposure_s
    assert all_of_them["cases"]["far_altitude_km_900"] == [900.0, exposure]
    assert value_at(suite.cases[0], "camera.band.vis.kind") == "solar"
    for key in ("attitude.nothing", "camera.band.nothing.kind", "camera.detector.exposure_s.more"):
        with pytest.raises(KeyError):
            value_at(suite.cases[0], key)
    for key in ("sun.nothing", "scene.name"):
        with pytest.raises(UserError):
            figure_plans(dataclasses.replace(suite, figures=[suite.figures[0].model_copy(update={"x": key})]))


def test_a_record_says_where_frame_and_images_lie() -> None:
    truth = truth_at()
    rows = [result_row(case="a", band="red"), result_row(case="a", band="blue")]
    record = record_of("a", truth, rows, {"x": 1}, {"": "f", "red": "r"})
    assert (record["truth_frame"], record["image"], record["images"]) == ("f", "r", {"red": "r"})
    assert [(row["frame_address"], row["image_address"]) for row in record["rows"]] == [("f", "r"), ("f", None)]
    assert (record["error"], record["scene_id"], record["details"]) == (None, truth.scene_id, {"x": 1})
    empty = record_of("a", truth, rows, {}, {})
    assert (empty["truth_frame"], empty["image"], empty["images"]) == (None, None, {})


def test_what_broke_has_a_row_for_every_estimator(suite) -> None:  # type: ignore[no-untyped-def]
    case, plan = suite.cases[0], plan_of(suite)
    record = failed_record("a", case, ["altitude-free", "ideal"], plan, "it\n  broke")
    assert record["error"] == "it broke"
    assert [row["estimator"] for row in record["rows"]] == ["altitude-free", "ideal"]
    assert {row["status"] for row in record["rows"]} == {"bad_input"}
    assert record["rows"][1]["expected"] == "valid", "who is given the pose can always answer"
    assert (record["image"], record["images"], record["truth_frame"]) == (None, {}, None)
    assert camera_name(case) == case.camera.camera.name


def test_an_observation_has_what_a_flight_computer_knows() -> None:
    truth = truth_at(roll_deg=66.0, mount_roll_deg=10.0)
    image = toy_image(truth)
    seen = observation_of(image, registry.get("altitude-free"))
    assert (seen.image == image.dn).all()
    assert (seen.full_scale, seen.band_kind, seen.oracle) == (1023.0, "solar", None)
    assert seen.q_cam_from_body == pytest.approx(np.array(truth.q_cam_from_body))
    assert seen.prior.flattening == pytest.approx(1 / 298.257223563)
    assert seen.prior.known == ("shape",)
    assert seen.prior.sphere_radius_m == MEAN_RADIUS_M
    hot = toy_image(
        truth_at(THERMAL_CAMERA | {"platform": {"altitude_km": 512.0, "altitude_sigma_km": 3.0}}, roll_deg=66.0)
    )
    told = observation_of(hot, registry.get("altitude-free"))
    assert (told.band_kind, told.prior.altitude_m, told.prior.altitude_sigma_m) == ("thermal", 512e3, 3e3)
    assert observation_of(image, registry.get("ideal")).oracle is not None
    light = RadianceFrame({"red": np.ones((480, 640), np.float32), "b": np.zeros((480, 640), np.float32)}, {}, truth)
    assert observation_of(light, registry.get("altitude-free")).full_scale is None
    assert observation_of(light, registry.get("altitude-free")).image.max() == 1.0
    assert observation_of(light, registry.get("altitude-free"), band="b").image.max() == 0.0
    heads = observation_of_heads({"left": image, "right": image}, registry.get("video-vertical"))
    assert list(heads.heads) == ["left", "right"]
    assert (heads.image == image.dn).all()


def test_a_method_is_told_the_spheres_own_radius_or_the_mean_one() -> None:
    assert method_radius_m(truth_at(ellipsoid=sphere(6.0e6))) == 6.0e6
    assert method_radius_m(truth_at()) == MEAN_RADIUS_M
    truth = truth_at(altitude_km=800.0)
    pose = oracle_pose(truth)
    distance = np.linalg.norm(truth.r_itrs)
    assert math.asin(pose.radius_m / distance) == pytest.approx(truth.angular_radius_rad)


@pytest.mark.parametrize(
    "text", ["", "1", "/", "0/2", "3/2", "a/2", "1/b", "1/", "/2", "1/2/3", "-1/2", "1.0/2", " 1/2"]
)
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(UserError, match="--shard"):
        parse_shard(text)
    assert parse_shard("1/1") == (1, 1)
    assert parse_shard("2/2") == (2, 2)
    assert parse_shard("12/340") == (12, 340)


@pytest.mark.parametrize("address", ["local:0", "local:", "local:x", "local:-1", "local:1.5", "local:999999"])
def test_what_is_no_number_of_local_workers_is_refused(address: str) -> None:
    with pytest.raises(UserError, match="--dask"):
        local_workers(address)
    assert local_workers("local:1") == 1
    assert local_workers("local:16") == 16
    assert local_workers("tcp://host:8786") is None


def test_a_suite_is_what_it_keeps_draws_and_runs(suite) -> None:  # type: ignore[no-untyped-def]
    """Each of it makes another suite; the time that an estimate may take does not."""
    changes = [{}, {"keep": "failures"}, {"keep": "none"}, {"draws": 3}, {"estimators": ("ideal",)}, {"name": "t"}]
    some = tuple(dataclasses.replace(case, estimators=("ideal",)) for case in suite.cases)
    changes += [{"cases": suite.cases[:3]}, {"cases": some}]
    digests = [suite_identity(dataclasses.replace(suite, **change)) for change in changes]
    assert len(set(digests)) == len(changes)
    assert suite_identity(dataclasses.replace(suite, time_limit_s=1.5, memory_limit_mb=99)) == digests[0]


def test_a_file_of_two_lines_lies_beside_its_suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [
        "1 25544U 98067A   26079.50000000  .00010000  00000-0  18000-3 0  999",
        "2 25544  51.6400 100.0000 0005000  60.0000 300.0000 15.50000000  100",
    ]
    digits = [sum(int(c) if c.isdigit() else c == "-" for c in line[:68].ljust(68)) % 10 for line in lines]
    text = "\n".join(f"{line.ljust(68)}{digit}" for line, digit in zip(lines, digits, strict=True))
    place = tmp_path / "plain"
    place.mkdir()
    (place / "sat.txt").write_text(text)
    orbit = '[[cases]]\nname = "o"\norbit = { tle = "sat.txt", n = 3 }\n'
    head = SUITE[: SUITE.index("[[cases]]")].replace("platform.altitude_km = 500.0", "")
    (place / "s.toml").write_text(head + orbit)
    monkeypatch.chdir(tmp_path)
    assert len(load_suite(tmp_path / "plain" / "s.toml").cases) == 3


def test_what_another_folder_has_is_taken_over_and_nothing_replaced(tmp_path: Path) -> None:
    source, target = tmp_path / "a", tmp_path / "b"
    for name, text in {"cases/one": "1", "cases/deep/two": "2", "cases/.lock": "x", "other/three": "3"}.items():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(text)
    (target / "cases").mkdir(parents=True)
    (target / "cases/one").write_text("mine")
    take_over(source, target, ["cases", "missing"], lambda path: not path.name.startswith("."))
    assert {p.relative_to(target).as_posix(): p.read_text() for p in target.rglob("*") if p.is_file()} == {
        "cases/one": "mine",
        "cases/deep/two": "2",
    }


def address(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def image(scene: str, *, head: str = "", band: str = "vis", seed: str = "0", epoch: str = "t") -> StoreEntry:
    name = f"{scene} {head} {band} {seed} {epoch}"
    return StoreEntry(
        address=address(name), kind="image", size_bytes=1, scene=scene, scene_id=f"id {scene} {head} {epoch}",
        camera="cam", bands=(band,), head=head, seed=seed, epoch_utc=epoch,
    )  # fmt: skip


def frame(scene: str, *, head: str = "", epoch: str = "t") -> StoreEntry:
    return StoreEntry(
        address=address(f"frame {scene} {head} {epoch}"), kind="frame", size_bytes=1, scene=scene,
        scene_id=f"id {scene} {head} {epoch}", camera="cam", bands=("vis",), head=head, epoch_utc=epoch,
    )  # fmt: skip


ALONE, HEADS = estimator("alone"), estimator("heads", needs="heads")


def test_bands_of_a_case_belong_together_and_have_its_frame():
    red, blue = image("noon", band="red"), image("noon", band="blue")
    (item,) = items_of([red, blue, frame("noon"), frame("night")], [ALONE])
    assert (item.name, item.together) == ("noon", False)
    assert item.images == {"": {"red": red.address, "blue": blue.address}}
    assert item.frames == {"": frame("noon").address}


def test_heads_have_names_of_their_own_and_a_common_one():
    left, right, other = image("s", head="left"), image("s", head="right"), image("one", head="left")
    items = items_of([left, right, other, frame("s", head="left")], [ALONE, HEADS])
    assert [(item.name, item.together, sorted(item.images)) for item in items] == [
        ("one", False, ["left"]),
        ("s", True, ["left", "right"]),
        ("s.left", False, ["left"]),
        ("s.right", False, ["right"]),
    ]
    assert [item.frames for item in items[1:]] == [
        {"left": frame("s", head="left").address, "right": ""},
        {"left": frame("s", head="left").address},
        {"right": ""},
    ]
    assert cases_of_heads(items) == {"s": [["left", "s.left"], ["right", "s.right"]]}
    assert [item.name for item in items_of([left, right], [HEADS])] == ["s"]
    assert cases_of_heads(items_of([left, right], [HEADS])) == {"s": []}


def test_draws_and_instants_of_one_scene_are_told_apart():
    many = [image("s"), image("s", seed="1"), image("s", epoch="later"), image("t")]
    items = items_of(many, [ALONE])
    assert sorted(item.name for item in items) == sorted([*(f"s.{one.address[:12]}" for one in many[:3]), "t"])
    # The same in another exposure: only the address differs.
    again = [many[3], StoreEntry(**(vars(many[3]) | {"address": address("longer")}))]
    assert len({item.name for item in items_of(again, [ALONE])}) == 2


def test_two_frames_that_could_be_meant_are_none():
    twice = [frame("noon"), StoreEntry(**(vars(frame("noon")) | {"address": address("other code")}))]
    assert items_of([image("noon"), *twice], [ALONE])[0].frames == {"": ""}


def test_the_air_that_a_prior_names_counts_by_its_content(tmp_path, make_image):
    table, store = tmp_path / "air.npz", Store(tmp_path / "archive")
    table.write_bytes(b"one air")
    addresses = {
        name: store.add_image(make_image(scene={"scene": {"name": name}, **prior}))
        for name, prior in {"knows": {"prior": {"climate": str(table)}}, "named": {"prior": {"climate": "us"}},
                            "none": {}}.items()
    }  # fmt: skip

    def identity(name: str) -> str:
        item = Item(name, {"": {"vis": addresses[name]}}, {})
        return rescored_identity(item.addresses, ["ideal"], CasePlan(("ideal",)), climates_of(item, store))

    before = {name: identity(name) for name in addresses}
    table.write_bytes(b"another air")
    after = {name: identity(name) for name in addresses}
    assert before["knows"] != after["knows"]
    assert (before["named"], before["none"]) == (after["named"], after["none"])
    table.unlink()
    assert identity("knows") not in (before["knows"], after["knows"])


def test_a_damaged_image_names_no_air(tmp_path, make_image):
    store = Store(tmp_path)
    address = store.add_image(make_image())
    store.path(address).write_bytes(b"no image")
    assert climates_of(Item("a", {"": {"vis": address}}, {}), store) == set()
