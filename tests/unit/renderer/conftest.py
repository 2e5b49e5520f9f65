"""The back-end, chosen before any module of the kernel is imported."""

from __future__ import annotations

from typing import Any

import pytest

from horizonval.renderer.backend import activate


@pytest.fixture(scope="session")
def mi() -> Any:
    activate()
    import mitsuba

    return mitsuba
