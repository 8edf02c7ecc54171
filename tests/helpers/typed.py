"""Check with pyright that the README's blocks have no type errors, and that planted errors are found.

``python tests/helpers/typed.py``; .ci/run calls it.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

#: a wrong keyword, a wrong attribute, a wrong type, and misspelt names of packages whose names are loaded lazily
PLANTED = """import adaptmg as am

problem = am.cases.greco_bar(law=am.Coulomb(0.3))
grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
solver = am.FullMultigrid(rtoll=1e-8)
result = am.solve(grids)
print(result.status, result.cycles)
pressure = result.contact.presure
figure = am.plot.contact(problem)
result.save("run.npz")
am.plot.contcat(result)
am.export.vtkk(result, "run.vtu")
am.study.Grdi({"sweeps": [1, 2]})
am.mesh.gradde(problem.domain, 1e-3)
"""
#: lines of the errors
WRONG = [5, 8, 9, 11, 12, 13, 14]


def errors_of(**sources: str) -> dict[str, list[tuple[int, str]]]:
    """Return the lines and rules of pyright's errors in each of some scripts, given by name."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / f"{name}.py").write_text(text, encoding="utf-8")
        settings = {"include": ["."], "extraPaths": [str(ROOT)], "typeCheckingMode": "basic", "pythonVersion": "3.11"}
        (Path(folder) / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
        run = subprocess.run([sys.executable, "-m", "pyright", "-p", folder, "--outputjson"], capture_output=True,
                             text=True)
        found: dict[str, list[tuple[int, str]]] = {name: [] for name in sources}
        for entry in json.loads(run.stdout)["generalDiagnostics"]:
            if entry["severity"] == "error":
                line = entry["range"]["start"]["line"] + 1
                found[Path(entry["file"]).stem].append((line, f"{entry['rule']}: {entry['message']}"))
    return found


def main() -> None:
    """Fail with the errors of the README's blocks, or with the planted ones that were not found."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    found = errors_of(readme="\n".join(blocks), planted=PLANTED)
    if found["readme"]:
        sys.exit("\n".join(f"README.md, line {line} of its blocks: {text}" for line, text in found["readme"]))
    if [line for line, _ in found["planted"]] != WRONG:
        sys.exit(f"planted errors in lines {WRONG}, found {found['planted']}")


if __name__ == "__main__":
    main()
