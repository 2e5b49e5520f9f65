"""What is known beside the image, through the commands: said, drawn, handed on, and made again from an archive."""

from __future__ import annotations

import json
import sys

import cv2
import pytest
from conftest import MINI_CAMERA, assert_one_line

from horizonval.plugins import registry
from horizonval.plugins.program import prior_file
from horizonval.scoring.row import read_results
from horizonval.store import exr
from horizonval.store.store import Store
from horizonval.suites.observation import observation_of

METHOD = ("--estimator", "altitude-free")
PROGRAM = """import json, sys
print(json.dumps({"status": "dark", "reason": open(sys.argv[1]).read()}))
"""
SUITE = f"""[suite]
name = "known"
estimators = ["echo", "altitude-free"]
[[estimator]]
name = "echo"
command = "{sys.executable} echo.py {{prior}}"
[defaults]
camera = {{ file = "mini-camera.toml", mount_roll_deg = 65.0, camera = {{ width = 24, height = 16 }} }}
platform.altitude_km = 500.0
render = {{ subsamples = 1, nodes = 16, orders = "single" }}
[defaults.prior]
altitude_sigma_km = 2.0
attitude_sigma_deg = [0.5, 0.5, 2.0]
[[cases]]
name = "to"
grid = {{ prior.position_sigma_km = [1.0, 10.0] }}
"""


def _report(done) -> dict:  # type: ignore[no-untyped-def]
    assert done.returncode == 0, done.stderr
    report: dict = json.loads(done.stdout)
    return report


def test_a_picture_says_what_was_assumed_and_can_be_given_more(horizonval, image_path, tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    cv2.imwrite(str(tmp_path / "i.png"), exr.read_image(image_path).dn)
    picture = ("i.png", "--camera", "mini-camera.toml", *METHOD)
    bare = _report(horizonval("estimate", *picture, "--json"))
    assert bare["status"] == "valid"
    camera = "; focal length to 0.05 %, principal point to 0.2 px, distortion to 0.1 px"
    assert bare["assumed"] == f"the Earth as a sphere of 6371.0088 km, its flattening as an error{camera}"

    (tmp_path / "p.toml").write_text('[prior]\nshape = "sphere"\nradius_km = 6300.0\n')
    small = _report(horizonval("estimate", *picture, "--prior", "p.toml", "--json"))
    # The cone's half-angle is asin(R / (R + h)): distances go with the radius.
    assert small["altitude_km"] / 6300.0 == pytest.approx(bare["altitude_km"] / 6371.0088, rel=1e-6)
    assert small["assumed"] == f"a sphere of 6300.0000 km{camera}"

    (tmp_path / "p.toml").write_text("[prior]\naltitude_km = 900.0\naltitude_sigma_km = 1.0\n")
    known = _report(horizonval("estimate", *picture, "--prior", "p.toml", "--json"))
    assert known["nadir_cam"] == bare["nadir_cam"], "a method that is free of the altitude does not use it"
    assert "altitude_km 900; altitude_sigma_km 1" in known["assumed"]


def test_an_image_of_ours_has_its_values_drawn(horizonval, image_path, tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "p.toml").write_text("[prior]\naltitude_sigma_km = 0.001\nposition_sigma_km = 1.0\n")
    report, again = (
        _report(horizonval("estimate", image_path, *METHOD, "--prior", "p.toml", "--json")) for _ in range(2)
    )
    assert report["assumed"] == again["assumed"]
    # 500 km to a metre: to the digits that are printed.
    assert "altitude_km 500.00" in report["assumed"] or "altitude_km 499.99" in report["assumed"]
    assert "position_itrs_km " in report["assumed"]
    plain = _report(horizonval("estimate", image_path, *METHOD, "--json"))
    assert plain["assumed"] == "WGS84, by spherical methods a sphere of 6371.0088 km"
    assert plain["nadir_cam"] == report["nadir_cam"], "a method that uses nothing of it answers the same"


def test_mistakes_are_one_line(horizonval, image_path, tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    cv2.imwrite(str(tmp_path / "i.png"), exr.read_image(image_path).dn)
    for text, words in (
        ("[prior]\nposition_sigma_km = 1.0\n", ["i.png", "position_sigma_km without position_itrs_km"]),
        ("[prior]\naltitude_km = 1.0\n", ["p.toml", "altitude_km without altitude_sigma_km"]),
        ('[prior]\nclimate = "tropicl"\n', ["p.toml", "prior.climate", "tropical"]),
    ):
        (tmp_path / "p.toml").write_text(text)
        done = horizonval("estimate", "i.png", "--camera", "mini-camera.toml", *METHOD, "--prior", "p.toml")
        assert_one_line(done, *words)
    assert_one_line(horizonval("estimate", image_path, *METHOD, "--prior", "none.toml"), "none.toml")


def test_a_suites_prior_is_drawn_once_and_made_again_from_its_archive(here, horizonval, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A program writes down what it was given; the archived images alone give the same bytes."""
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    (tmp_path / "echo.py").write_text(PROGRAM)
    (tmp_path / "known.toml").write_text(SUITE)
    done = horizonval("run", "known.toml", "--out", "out")
    assert done.returncode in (0, 1), done.stderr
    rows = read_results(tmp_path / "out" / "results.parquet")
    given = {row.case: str(row.reason) for row in rows if row.estimator == "echo"}
    assert len(given) == 2
    store = Store(tmp_path / "out" / "archive")
    images = [store.read_image(entry.address) for entry in store.index.select() if entry.kind == "image"]
    priors = {image.truth.scene_name: observation_of(image, registry.get("altitude-free")).prior for image in images}
    for case, reason in given.items():
        assert priors[case].known == ("shape", "altitude_m", "r_itrs", "q_cam_from_itrs", "epoch_utc")
        assert prior_file(priors[case]).split() == reason.split()
    # Frames of one place are rendered from one viewpoint: each has what is known of it, not of the one before.
    page = (tmp_path / "out" / "report" / "index.html").read_text(encoding="utf-8")
    assert all(prior.in_words in page for prior in priors.values())
    assert [priors[f"to_position_sigma_km_{km}"].position_sigma_m for km in (1, 10)] == [1e3, 1e4]
    done = horizonval("archive", "rescore", "out", "-o", "again", *METHOD)
    assert done.returncode in (0, 1), done.stderr
    again = {row.case: row for row in read_results(tmp_path / "again" / "results.parquet")}
    for row in rows:
        if row.estimator == "altitude-free":
            assert (again[row.case].status, again[row.case].reason) == (row.status, row.reason)
