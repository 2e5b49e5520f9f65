"""The snippet that stands at the head of the package: it runs as it stands, and a type checker has nothing to say."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap

import pytest

import horizonval as hv

WIDE = {
    "fov_deg = 60.0": 'projection = "fisheye"\nfov_deg = 160.0',
    "width = 64": "width = 128",
    "height = 64": "height = 128",
    "exposure_s = 2.0e-4": "exposure_s = 6e-5",
}
"""A camera that looks to the nadir and has the whole horizon in view."""


@pytest.fixture(scope="module")
def snippet(user_folder, tmp_path_factory):
    """The script, in a folder with the two files that it names."""
    folder = tmp_path_factory.mktemp("snippet")
    block = re.search(r"\n::\n\n(.*?)\n\n\S", hv.__doc__ or "", re.S)
    assert block is not None
    script = folder / "script.py"
    script.write_text(textwrap.dedent(block[1]) + "\nprint(run.rows().fetchall()[0][0])\n")
    camera = (user_folder / "mycam.toml").read_text()
    for old, new in WIDE.items():
        assert old in camera
        camera = camera.replace(old, new)
    (folder / "mycam.toml").write_text(camera)
    suite = (user_folder / "orbit.toml").read_text().replace("mount_roll_deg = 65.0", "mount_roll_deg = 0.0")
    (folder / "orbit.toml").write_text(suite)
    return script


def test_it_runs_as_a_plain_script(snippet):
    done = subprocess.run(
        [sys.executable, snippet.name], cwd=snippet.parent, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr
    *report, error, first_row = done.stdout.splitlines()
    assert report[0].startswith("scene scene")
    assert 0.0 < float(error) < 1.0
    assert first_row == "one"
    assert (snippet.parent / "out" / "report" / "index.html").is_file()


@pytest.mark.slow
def test_strict_types_find_nothing_in_it_and_wrong_use_elsewhere(snippet):
    """One run of the checker for both: without errors in a wrong script, silence would prove nothing."""
    wrong = snippet.with_name("wrong.py")
    wrong.write_text('import horizonval as hv\n\nhv.Scene(camera="x", altitude=550)\nhv.render(3)\n')
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", snippet.name, wrong.name],
        cwd=snippet.parent,
        capture_output=True,
        text=True,
        timeout=500,
    )
    errors = [line.split(":")[:2] for line in done.stdout.splitlines() if ": error:" in line]
    assert errors == [["wrong.py", "3"], ["wrong.py", "4"]], done.stdout + done.stderr
