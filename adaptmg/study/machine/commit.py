"""The commit of adaptmg, where it runs from a git repository; read from its files, as git need not be installed."""

from __future__ import annotations

from functools import cache
from pathlib import Path

__all__ = ["commit"]


@cache
def commit() -> str:
    """Hexadecimal, empty where there is no repository."""
    try:
        return _head(Path(__file__).resolve().parents[3])
    except (OSError, ValueError):
        return ""


def _head(root: Path) -> str:
    git = root / ".git"
    if git.is_file():  # a working tree beside its repository
        git = root / git.read_text(encoding="utf-8").removeprefix("gitdir:").strip()
    if not git.is_dir():
        return ""
    head = (git / "HEAD").read_text(encoding="utf-8").strip()
    if not head.startswith("ref:"):
        return head
    name = head.removeprefix("ref:").strip()
    common = git / "commondir"
    base = git / common.read_text(encoding="utf-8").strip() if common.is_file() else git
    for place in (git, base):
        if (place / name).is_file():
            return (place / name).read_text(encoding="utf-8").strip()
    for line in (base / "packed-refs").read_text(encoding="utf-8").splitlines():
        if line.endswith(f" {name}"):
            return line.split()[0]
    return ""
