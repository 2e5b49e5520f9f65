"""What the estimators of a run claimed, as attitude messages: read back, they are the truth plus the errors scored."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import numpy as np
import pytest
import tifffile
from conftest import MINI_CAMERA
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.cli.app import run_command_line
from horizonval.formats.aem import attitude_of_aem
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.store.store import Store

SUITE = """
[suite]
name = "pass"
estimators = ["altitude-free", "ideal"]
[defaults]
camera = { file = "mini-camera.toml", mount_roll_deg = 65.0 }
render = { subsamples = 1, nodes = 32, orders = "single" }
[[cases]]
name = "orbit"
[cases.orbit]
altitude_km = 500.0
inclination_deg = 40.0
epoch_utc = 2026-03-20T12:00:00Z
duration_s = 30.0
n = 3
attitude = { offset_deg = [15.0, 2.0, -1.0] }
"""


CROWD = """
[[cases]]
name = "other"
grid.platform.latitude_deg = [-20.0, 20.0]
[cases.base]
platform = { altitude_km = 500.0, epoch_utc = 2026-03-20T12:00:10Z }
"""


@pytest.fixture(scope="module")
def exported(here, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    (folder / "mini-camera.toml").write_text(MINI_CAMERA)
    (folder / "pass.toml").write_text(SUITE)
    run = hv.run(folder / "pass.toml", out=folder / "out", workers=1, progress=False)
    words = ["archive", "export", str(folder / "out"), "-o", str(folder / "files"), "--aem", "--coco", "--tiff"]
    assert run_command_line(words) == 0
    return run, folder / "files"


def test_messages_are_truth_and_errors(exported):
    run, files = exported
    assert {path.name for path in files.glob("*.aem")} == {"attitude-altitude-free.aem", "attitude-ideal.aem"}
    store = Store(run.out / "archive")
    for name in ("altitude-free", "ideal"):
        rows = run.rows().filter(f"estimator = '{name}' AND status = 'valid'").order("epoch_utc")
        found = attitude_of_aem(files / f"attitude-{name}.aem")
        for epoch, roll, pitch, address in rows.project(
            "epoch_utc, roll_error_arcsec, pitch_error_arcsec, image_address"
        ).fetchall():
            truth = hv.open_image(store.path(address)).truth
            time = datetime.fromisoformat(str(epoch)).replace(tzinfo=UTC)
            true = Rotation.from_quat(truth.q_cam_from_body).inv() * Rotation.from_quat(truth.q_cam_from_itrs)
            claimed = found.body_from_gcrs(time, np.zeros(1))[0] @ itrs_from_gcrs(time).T
            # Small angles: an error of roll turns about x, one of pitch about the y of before the roll of -1 deg.
            turn = Rotation.from_matrix(claimed @ true.as_matrix().T).as_rotvec(degrees=True) * 3600.0
            assert turn[0] == pytest.approx(-roll, abs=0.1)
            assert turn[1] == pytest.approx(-pitch, abs=0.03 * abs(pitch) + 0.1)


def test_a_message_counts_what_it_leaves_out(exported, capsys):
    folder = exported[1].parent
    (folder / "crowd.toml").write_text(SUITE + CROWD)
    crowd = hv.run(folder / "crowd.toml", out=folder / "crowd", workers=1, progress=False)
    assert run_command_line(["archive", "export", str(folder / "crowd"), "-o", str(folder / "m"), "--aem"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in ("altitude-free", "ideal"):
        text = (folder / "m" / f"attitude-{name}.aem").read_text()
        rows = crowd.rows().filter(f"estimator = '{name}'")
        total = len(rows)
        left_out = "Claims left out because another scene, head or draw has the line of their instant"
        times = [str(row[0]) for row in rows.filter("status = 'valid'").project("epoch_utc").fetchall()]
        assert len(times) > len(set(times)) == len(re.findall("^2026", text, re.M))
        said = (
            f"Claims in this message: {len(set(times))}. Frames without a line because the estimator refused them: "
            f"{total - len(times)}."
        )
        left = f"{left_out}: {len(times) - len(set(times))} ("
        assert f"COMMENT {said}\nCOMMENT {left}" in text
        assert any(line.startswith(f"{folder}/m/attitude-{name}.aem: {said} {left}") for line in lines)
        assert attitude_of_aem(folder / "m" / f"attitude-{name}.aem")


def test_pictures_and_masks_lie_beside_them(exported):
    files = exported[1]
    pictures = sorted(files.glob("*.tif"))
    assert len(pictures) == 6
    # Their descriptions are whole ones, which tifffile may take for its own.
    assert {tifffile.imread(path).shape for path in pictures} == {(80, 96)}
    assert (files / "masks.json").is_file()
