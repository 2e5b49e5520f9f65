"""Suite files: many scenes that share defaults, and the estimators to score on them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.stability import StabilitySpec


class SuiteHead(Model):
    """What the suite is."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")]
    title: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    estimators: Annotated[list[str], Field(min_length=1)]


class SuiteSpec(Model):
    """One suite file.

    ``[defaults]`` is a partial scene; every ``[[frame]]`` is a partial scene laid over it, with a unique
    ``scene.name``. ``[stability]`` asks for a study of the infrared horizon beside the frames.
    """

    suite: SuiteHead
    defaults: dict[str, Any] = {}
    frame: Annotated[list[dict[str, Any]], Field(min_length=1)]
    stability: StabilitySpec | None = None

    @model_validator(mode="after")
    def _unique_names(self) -> SuiteSpec:
        seen: set[str] = set()
        for i, frame in enumerate(self.frame):
            name = frame.get("scene", {}).get("name") if isinstance(frame.get("scene", {}), dict) else None
            if not isinstance(name, str):
                raise ValueError(f"frame {i + 1} has no scene.name")
            if name in seen:
                raise ValueError(f"two frames are named {name!r}")
            seen.add(name)
        return self
