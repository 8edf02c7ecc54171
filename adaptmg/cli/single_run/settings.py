"""Settings of a run, by ``"section.key"``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["Settings", "section"]

Settings = Mapping[str, Any]


def section(settings: Settings, name: str) -> dict[str, Any]:
    """The settings of a section, by key."""
    return {key[len(name) + 1:]: value for key, value in settings.items() if key.startswith(f"{name}.")}
