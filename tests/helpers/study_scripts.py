"""Loading the scripts of studies/ and tests/campaigns/ as modules."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

STUDIES = Path(__file__).resolve().parents[2] / "studies"
FOLDERS = (str(STUDIES), str(Path(__file__).resolve().parents[1] / "campaigns"))


def load(name: str) -> ModuleType:
    """The module of a study script, as it is when the script's folder is on the path."""
    sys.path[:0] = [folder for folder in FOLDERS if folder not in sys.path]
    return importlib.import_module(name)
