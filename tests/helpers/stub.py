"""Write ``adaptmg/__init__.pyi`` for type checkers and completion: ``python tests/helpers/stub.py``."""

from pathlib import Path

import adaptmg

PATH = Path(adaptmg.__file__).with_suffix(".pyi")


def stub() -> str:
    """Return the text of the stub that belongs to the table of names in ``adaptmg/__init__.py``."""
    lines = ["# Written by tests/helpers/stub.py from the table of names in __init__.py.", ""]
    modules = {"adaptmg": adaptmg._SUBMODULES, **adaptmg._WHERE}
    for module, names in sorted(modules.items()):
        lines += [f"from {module} import {name} as {name}" for name in sorted(names)]
    return "\n".join([*lines, "", "__version__: str", "_HOME: dict[str, str]", "_SUBMODULES: tuple[str, ...]", ""])


if __name__ == "__main__":
    PATH.write_text(stub(), encoding="utf-8")
