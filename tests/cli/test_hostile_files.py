"""Study files that are wrong: each gives one line that names file, line and what to write, before anything runs."""

from pathlib import Path

import pytest

from adaptmg.cli.study_file import checked, read

GOOD = """name = "bar"

[case]
case = "greco_bar"
friction = 0.3

[hierarchy]
divisions = [2, 4]

[solver]
method = "multigrid"
pre = 2

[measure]
columns = ["cycles"]

[vary]
"case.size" = [0.2, 1.0]
"""
F, D, S, P, M, V, N = ("friction = 0.3", "divisions = [2, 4]", "[solver]", "pre = 2", 'columns = ["cycles"]', "[vary]",
                       'name = "bar"')
VARIED = '"case.size" = [0.2, 1.0]'


def told(content: str | bytes) -> str:
    """The message for a file."""
    path = Path("study.toml")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises((ValueError, OSError)) as error:
        checked(read(path), None)
    text = str(error.value)
    assert "\n" not in text and len(text) < 700 and sorted(Path().iterdir()) == [path]
    return text


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_the_file_they_spoil_is_right():
    Path("study.toml").write_text(GOOD, encoding="utf-8")
    assert len(checked(read("study.toml"), None)) == 2


@pytest.mark.parametrize(("old", "new", "line", "words"), [
    ("[case]", "[Case]", 3, "did you mean 'case'"), (S, "[solver]\n[solver]", 11, "not TOML: Cannot declare"),
    (S, "[solver.method]", 11, "no key 'method.method'"), (N, 'method = "x"', 1, "it belongs below [solver]"),
    (N, 'name = "../x"', 1, "becomes that of files"), (F, "frictoin = 0.3", 5, "did you mean 'friction'"),
    (M, "keeps = true", 15, "did you mean 'keep'"), (VARIED, '"size" = [0.2]', 18, "did you mean 'case.size'"),
    (VARIED, '"run.workers" = [2]', 18, "cannot be varied"), (VARIED, f"{VARIED}\ncase.size = [3.0]", 18, "twice"),
    (F, "friction = true", 5, "must be a number"), (F, "friction = nan", 5, "must be finite"),
    (F, "friction = {a = 1}", 5, "no key 'friction.a'"), (F, "top_pressure = 1e300", 5, "at most 1e+40"),
    (F, 'law = "tresca"', 5, "tresca needs case.limit"),
    (F, f'{F}\nlaw = "frictionless"', 5, "it belongs to case.law coulomb"),
    (D, "divisions = 4", 8, "must be a list of whole numbers"), (D, "divisions = [4, 2]", 8, "coarse to fine"),
    (D, "divisions = [1000000]", 8, "1e+12 nodes"), (D, f"{D}\nsizes = [1e-2]", 8, "not both"),
    (D, "sizes = [10, 5]", 8, "sizes are in m"), (D, "sizes = [1e-9]", 8, "nodes, at most 5e+06"),
    (D, "sizes = [1e-2]\ncontact_ratio = 1e9", 8, "nodes, at most"),
    (D, 'transfer = "l2"', 8, "has no meaning for uniform grids"), (D, f"{D}\nlevels = 2", 9, "bisect one grid"),
    (P, "condensed = true", 12, "belongs to single-grid"), (P, 'gap = "largest"', 12, "solver.correction paper"),
    (P, "rtol = 1", 12, "must be > 0 and < 1"), (P, "coarse.rtol = 2", 12, "rtol"),
    (P, 'linear = "amg"', 12, "solver.linear has no meaning for solver.method multigrid"),
    (M, 'columns = "cycles"', 15, "must be a list of names"), (M, "points = [[0, 0]]", 15, "must be values by name"),
    (M, "points = {A = [0.0]}", 15, "must be a vector of 2 numbers"),
    (M, 'forces_on = ["botom"]', 15, "did you mean 'bottom'"),
    (VARIED, '"case.size" = 0.2', 18, "must be a list of values, got 0.2"),
    (VARIED, '"case.size" = [0.2, "x"]', 18, "must be a number, got 'x'"),
    (VARIED, '"case.size" = [0.2, 0.2]', 18, "holds a value twice"),
    (VARIED, '"case.case" = ["greco_bar", "nothing"]', 18, "there is no case 'nothing'"),
    (VARIED, '"case.case" = ["greco_bar", "dovetail"]\n"case.side_pressure" = [1.0]', 19, "no key 'side_pressure'"),
    (VARIED, "\n".join(f'"case.{key}" = {[k / 1000 for k in range(1, 200)]}' for key in ("friction", "size", "young")),
     17, "at most 2000000"),
    (V, '[design]\nkind = "lhs"\n[vary]', 18, "must be one of 'grid'"),
    (V, "[load_path]\nright = [1.0]\n[vary]", 18, "no load there"),
    (V, "[load_path]\nleft = [1.0, 2.0]\ntop = [1.0]\n[vary]", 18, "same number of steps"),
    (V, "[adapt]\nmax_nodes = 9\n[vary]", 7, "not both"),
    (V, '[run]\ncost = "x"\n[vary]', 18, "no setting or measure 'x'"),
    (V, '[run]\nscheduler = "tcp://x:1"\n[vary]', 18, "[run] has no key 'scheduler'")])
def test_a_wrong_line_is_named(old, new, line, words):
    assert old in GOOD
    text = told(GOOD.replace(old, new, 1))
    assert text.startswith(f"study.toml, line {line}: ") and words in text, text


@pytest.mark.parametrize(("given", "line", "words"), [
    ("start = 5.0\nmax_nodes = 9", 8, "m is more than the body is long"), ("start = 5e-3", 7, "at least one of"),
    ('max_nodes = 9\nindicator = "goal"', 9, "goal needs adapt.quantity"),
    ('max_nodes = 9\nindicator = "goal"\nquantity = "displacement"', 10, "displacement needs adapt.points"),
    ('max_nodes = 9\nquantity = "opening"', 9, "belongs to adapt.indicator goal"),
    ("max_nodes = 9\ncoarsen = 0.1", 9, "belongs to adapt.engine bisect")])
def test_a_wrong_adaptation_is_named(given, line, words):
    text = told(GOOD.replace(f"[hierarchy]\n{D}", f"[adapt]\n{given}").replace(P, ""))
    assert text.startswith(f"study.toml, line {line}: ") and words in text, text


@pytest.mark.parametrize(("content", "words"), [
    ("", "there is no section [case]"), ("# nothing\n", "there is no section [case]"),
    (bytes(range(256)), "line 2: not TOML: save it as text in UTF-8"), (GOOD.encode("utf-16"), "as text in UTF-8"),
    (GOOD.replace("bar", "b\xe4r").encode("latin-1"), "line 1: not TOML: save it as text"),
    ("a = " + "[" * 9000, "maximum recursion depth"), ("a = " + "9" * 5000, "digits"),
    (GOOD.replace('"greco_bar"', '"\u202egreco"'), "control characters")])
def test_what_is_no_study_file(content, words):
    assert words in told(content)


@pytest.mark.parametrize("content", [f"\ufeff{GOOD}", GOOD.replace("\n", "\r\n"),
                                     GOOD.replace('"case.size"', "case.size"),
                                     GOOD.replace('[vary]\n"case.size"', "[vary.case]\nsize")],
                         ids=["mark of Windows", "line ends of Windows", "dotted keys", "table of a section"])
def test_what_may_look_different(content):
    Path("study.toml").write_bytes(content.encode())
    said = read("study.toml")
    assert said.design.names == ("case.size",) and len(said.design) == 2


def test_a_folder_a_device_and_no_file():
    for path, words in ((".", "directory"), ("/dev/zero", "more than 1000000 bytes"), ("none.toml", "No such")):
        with pytest.raises((ValueError, OSError), match=words):
            read(path)
