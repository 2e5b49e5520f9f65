"""Code blocks of Markdown pages, run as a reader would: from top to bottom, in one empty folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(r"^```(?P<head>[^\n]*)\n(?P<body>.*?)^```", flags=re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"\{code-block\} \w+")
RUN = ("sh", "python")
"""Languages whose blocks are run; a block with a caption is a file, which is written."""
SHOWN = ("text", "{toctree}", "{include}", "{literalinclude}")
"""All other kinds of blocks: what is printed or computed, and parts of pages."""


@dataclass(frozen=True)
class Block:
    """One block: commands, a script, or a file with its name."""

    kind: str
    text: str
    file: str = ""


@dataclass(frozen=True)
class Done:
    """What became of one command or script."""

    command: str
    result: subprocess.CompletedProcess[str]
    processor_s: float


def blocks(text: str) -> Iterator[Block]:
    """Yield the blocks of a page that are run or written, in order."""
    for match in _FENCE.finditer(text):
        head, body = match["head"].strip(), match["body"]
        if _FILE.fullmatch(head):
            option, _, rest = body.partition("\n")
            assert option.startswith(":caption: "), f"a file needs a name: {body[:60]}"
            yield Block("file", rest.lstrip("\n"), option.removeprefix(":caption: ").strip())
        elif head in RUN:
            yield Block(head, body)
        else:
            assert head.split(" ")[0] in SHOWN, f"a block that nothing runs: {head}"


def commands(block: Block) -> list[str]:
    """Return the commands of a block; a script is one."""
    return [line for line in block.text.splitlines() if line.strip()] if block.kind == "sh" else [block.text]


def run_page(text: str, folder: Path, program: Path, skip: frozenset[str] = frozenset()) -> list[Done]:
    """Run a page in a folder, up to the first command that fails.

    ``pip install`` of a folder that the page wrote is done by hand, offline: what matters of it is the entry points.
    """
    path = os.pathsep.join([str(program.parent), os.environ["PATH"]])
    env = os.environ | {"PATH": path, "PYTHONPATH": os.pathsep.join([str(folder / "site"), _python_path()])}
    done: list[Done] = []
    for block in blocks(text):
        if block.kind == "file":
            target = folder / block.file
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text, encoding="utf-8")
            continue
        for command in commands(block):
            if command in skip:
                continue
            if command.startswith("pip install ./"):
                _install(folder / command.removeprefix("pip install ./"), folder / "site")
                continue
            words = ["bash", "-c", command] if block.kind == "sh" else [sys.executable, "-c", command]
            before = os.times()
            result = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True, check=False)
            after = os.times()
            spent = after.children_user + after.children_system - before.children_user - before.children_system
            done.append(Done(command, result, spent))
            if result.returncode != 0:
                return done
    return done


def _python_path() -> str:
    return os.environ.get("PYTHONPATH", "")


def _install(project: Path, site: Path) -> None:
    """Do to a folder of one module and a pyproject.toml what ``pip install`` would."""
    about = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = site / f"{about['name'].replace('-', '_')}-{about['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {about['name']}\nVersion: {about['version']}\n")
    groups = [
        "\n".join([f"[{group}]", *(f"{key} = {value}" for key, value in points.items())])
        for group, points in about.get("entry-points", {}).items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups) + "\n", encoding="utf-8")
    (info / "direct_url.json").write_text(json.dumps({"url": project.as_uri(), "dir_info": {}}), encoding="utf-8")
    for module in project.glob("*.py"):
        (site / module.name).write_text(module.read_text(encoding="utf-8"), encoding="utf-8")
