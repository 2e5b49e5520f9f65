"""Nights in small."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from nights import SUITE, Night, rendered

from horizonval.jobs import engine


@pytest.fixture(scope="session")
def night(tmp_path_factory: pytest.TempPathFactory) -> Night:
    """Eight scenes of 96 pixels."""
    return rendered(tmp_path_factory.mktemp("tiny") / "tiny.toml", SUITE)


@pytest.fixture(scope="module")
def here() -> Iterator[pytest.MonkeyPatch]:
    """Do units in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))
        yield patch
