"""The documentation is built without a warning, and its reference has every key, column, command and public name."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import horizonval
from horizonval.cli.app import app
from horizonval.scoring.row import COLUMNS
from horizonval.spec.schema import MODELS, tables

ROOT = Path(__file__).parents[2]
pytest.importorskip("sphinx", reason="needs the extra `docs`")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built pages; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-b",
        "html",
        str(ROOT / "docs"),
        str(folder),
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return folder


def _text(page: Path) -> str:
    return html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("kind", MODELS)
def test_every_key_of_a_file_is_in_the_reference(site, kind):
    page = (site / "reference" / "generated" / f"{kind}-keys.html").read_text(encoding="utf-8")
    text = _text(site / "reference" / "generated" / f"{kind}-keys.html")
    for table in tables(kind):
        assert table.header in text
        for key in table.keys:
            assert f'<span class="pre">{key.name}</span>' in page, (table.header, key.name)
            assert key.meaning.split(":")[0].split("`")[0].strip() in text, (table.header, key.name)


def test_every_column_of_the_results_is_in_the_reference(site):
    text = _text(site / "reference" / "generated" / "results.html")
    for column in COLUMNS:
        assert column.name in text
        assert column.meaning[:40] in text


def test_every_command_is_in_the_reference(site):
    text = _text(site / "reference" / "generated" / "command-line.html")
    for name in typer.main.get_command(app).commands:
        assert f"Usage: horizonval {name}" in text


def test_every_public_name_is_in_the_reference(site):
    page = (site / "reference" / "generated" / "api.html").read_text(encoding="utf-8")
    for name in getattr(horizonval, "__all__", ()):
        assert f'id="horizonval.{name}"' in page, name


def test_pages_need_no_network(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for tag in re.findall(r"<(?:script|img|link)[^>]+>", text):
            assert not re.search(r'(?:src|href)="https?://', tag) or 'rel="canonical"' in tag, (page.name, tag)
