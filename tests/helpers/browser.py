"""Chromium without a window, where it is installed: what a page measures."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))),
    None,
)

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


def _run(folder: Path, page: Path, width: int, height: int, *flags: str) -> bytes:
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--disable-dev-shm-usage",
        f"--user-data-dir={folder / 'browser'}",
        f"--window-size={width},{height}",
        *flags,
        page.as_uri(),
    ]
    return subprocess.run(command, capture_output=True, check=True, timeout=120).stdout


def dom(folder: Path, page: Path) -> str:
    """A page as it stands after its scripts have run."""
    return _run(folder, page, 1600, 800, "--virtual-time-budget=2000", "--dump-dom").decode()


def measure(folder: Path, text: str, script: str) -> Any:
    """The value of a function body in a page without its policy, in a frame for ``resize(width,
    height)``."""
    free = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    added = (
        "<script>function resize(width, height) { var style = window.frameElement.style;\n"
        "style.width = width + 'px'; style.height = (height || 900) + 'px'; }\n"
        f"parent.document.body.dataset.measured = JSON.stringify((function () {{ {script} }})());</script></body>"
    )
    page = folder / "measured.html"
    framed = html.escape(free.replace("</body>", added))
    page.write_text(
        f'<!DOCTYPE html><html><body><iframe style="width:1440px;height:900px;border:0" srcdoc="{framed}">'
        "</iframe></body></html>",
        encoding="utf-8",
    )
    return json.loads(html.unescape(re.search(r'data-measured="([^"]*)"', dom(folder, page))[1]))
