"""What a JSON text or a TOML file holds, as Python reads it."""

from __future__ import annotations

from typing import Any

JsonObject = dict[str, Any]
"""An object of a JSON text, or a table of a TOML file: keys are text, values whatever the format allows."""
