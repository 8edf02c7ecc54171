"""Loading the scripts of studies/ and tests/campaigns/ as modules."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ROOT / "studies"


def load(name: str) -> ModuleType:
    """The module of a script, as it is when the script's folder is on the path."""
    for folder in (STUDIES, ROOT / "tests" / "campaigns"):
        if str(folder) not in sys.path:
            sys.path.append(str(folder))
    return importlib.import_module(name)
