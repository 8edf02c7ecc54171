"""Study files that are wrong: each gives one line that names the file and what to write, before anything runs."""

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
correction = "monotone"
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


@pytest.mark.parametrize(("old", "new", "words"), [
    ("[case]", "[Case]", "did you mean 'case'"), (S, "[solver]\n[solver]", "Cannot declare"),
    (S, "[solver.method]", "no key 'method.method'"), (N, 'method = "x"', "it belongs below [solver]"),
    (N, 'name = "../x"', "becomes that of files"), (F, "frictoin = 0.3", "did you mean 'friction'"),
    (M, "keeps = true", "did you mean 'keep'"), (VARIED, '"size" = [0.2]', "did you mean 'case.size'"),
    (VARIED, '"run.workers" = [2]', "cannot be varied"), (VARIED, f"{VARIED}\ncase.size = [3.0]", "twice"),
    (F, "friction = true", "must be a number"), (F, "friction = nan", "must be finite"),
    (F, "friction = {a = 1}", "no key 'friction.a'"), (F, "top_pressure = 1e300", "at most 1e+40"),
    (F, 'law = "tresca"', "tresca needs case.limit"),
    (F, f'{F}\nlaw = "frictionless"', "it belongs to case.law coulomb"),
    (D, "divisions = 4", "must be a sequence of whole numbers"), (D, "divisions = [4, 2]", "coarse to fine"),
    (D, "divisions = [1000000]", "1e+12 nodes"), (D, f"{D}\nsizes = [1e-2]", "not both"),
    (D, "sizes = [10, 5]", "sizes are in m"),
    (D, 'transfer = "l2"', "has no meaning for uniform grids"), (D, f"{D}\nlevels = 2", "bisect one grid"),
    (P, "condensed = true", "belongs to single-grid"), (P, 'gap = "largest"', "solver.correction paper"),
    (P, "rtol = 1", "must be > 0 and < 1"), (P, "coarse.rtol = 2", "rtol"),
    (P, 'linear = "amg"', "solver.linear has no meaning for solver.method multigrid"),
    (M, 'columns = "cycles"', "must be a list of names"), (M, "points = [[0, 0]]", "must be values by name"),
    (M, "points = {A = [0.0]}", "must be a vector of 2 numbers"),
    (M, 'forces_on = ["botom"]', "did you mean 'bottom'"),
    (VARIED, '"case.size" = 0.2', "must be a list of values, got 0.2"),
    (VARIED, '"case.size" = [0.2, "x"]', "must be a number, got 'x'"),
    (VARIED, '"case.size" = [0.2, 0.2]', "holds a value twice"),
    (VARIED, '"case.case" = ["greco_bar", "nothing"]', "there is no case 'nothing'"),
    (VARIED, '"case.case" = ["greco_bar", "dovetail"]\n"case.side_pressure" = [1.0]', "no key 'side_pressure'"),
    (VARIED, "\n".join(f'"case.{key}" = {[k / 1000 for k in range(1, 200)]}' for key in ("friction", "size", "young")),
     "at most 2000000"),
    (V, '[design]\nkind = "lhs"\n[vary]', "must be one of 'grid'"),
    (V, "[load_path]\nright = [1.0]\n[vary]", "no load there"),
    (V, "[load_path]\nleft = [1.0, 2.0]\ntop = [1.0]\n[vary]", "same number of steps"),
    (V, "[adapt]\nmax_nodes = 9\n[vary]", "not both"),
    (V, '[run]\ncost = "x"\n[vary]', "no setting or measure 'x'"),
    (V, '[run]\nscheduler = "tcp://x:1"\n[vary]', "[run] has no key 'scheduler'")])
def test_what_is_wrong_is_named(old, new, words):
    assert old in GOOD
    text = told(GOOD.replace(old, new, 1))
    assert text.startswith("study.toml: ") and words in text, text


@pytest.mark.parametrize(("given", "words"), [
    ("start = 5.0\nmax_nodes = 9", "m is more than the body is long"), ("start = 5e-3", "at least one of"),
    ('max_nodes = 9\nindicator = "goal"', "goal needs adapt.quantity"),
    ('max_nodes = 9\nindicator = "goal"\nquantity = "displacement"', "displacement needs adapt.points"),
    ('max_nodes = 9\nquantity = "opening"', "belongs to adapt.indicator goal"),
    ("max_nodes = 9\npasses = 1", "belongs to adapt.engine bisect")])
def test_a_wrong_adaptation_is_named(given, words):
    text = told(GOOD.replace(f"[hierarchy]\n{D}", f"[adapt]\n{given}").replace(P, ""))
    assert text.startswith("study.toml: ") and words in text, text


@pytest.mark.parametrize(("content", "words"), [
    ("", "there is no section [case]"), ("# nothing\n", "there is no section [case]"),
    (GOOD.encode("utf-16"), "'utf-8' codec can't decode"),
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
