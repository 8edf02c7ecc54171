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
    # sections
    ("[case]", "[Case]", 3, "did you mean 'case'"), (S, "[[solver]]", 10, "must be one section"),
    (S, "[solver", 10, "not TOML"), (S, "[solver]\n[solver]", 11, "not TOML: Cannot declare"),
    (S, "[solver.method]", 11, "no key 'method.method'"), (N, 'method = "x"', 1, "it belongs below [solver]"),
    (N, 'name = "../x"', 1, "becomes that of files"), (N, 'store = ""', 1, "store must be text"),
    ("[case]", "[case.case]", 3, "must be a string"),
    # keys
    (F, "frictoin = 0.3", 5, "did you mean 'friction'"), (F, "radius = 3.0", 5, "[case] has no key 'radius'"),
    (P, "tol = 1e-8", 12, "did you mean 'rtol'"), (M, "keeps = true", 15, "did you mean 'keep'"),
    (VARIED, '"size" = [0.2]', 18, "did you mean 'case.size'"),
    (VARIED, '"run.workers" = [2]', 18, "cannot be varied"), (VARIED, f"{VARIED}\ncase.size = [3.0]", 18, "twice"),
    (VARIED, '"case." = [0.2]', 18, "cannot be varied"),
    # types and values
    (F, "friction = true", 5, "must be a number"), (F, "friction = nan", 5, "must be finite"),
    (F, "friction = 1e400", 5, "must be finite"), (F, "friction = 07:32:00", 5, "must be a number"),
    (F, "friction = -1", 5, ">= 0"), (F, 'friction = "much"', 5, "must be a number"),
    (F, "friction = {a = 1}", 5, "no key 'friction.a'"), (F, "friction = .5", 5, "not TOML"),
    (F, "friction = 0,3", 5, "not TOML"), (F, "friction = much", 5, "not TOML"), (F, "friction =", 5, "not TOML"),
    (F, 'young = "130 GPa"', 5, "must be a number"), (F, "young = -1", 5, "young must be > 0"),
    (F, "poisson = 0.5", 5, "poisson must lie between"), (F, "top_pressure = 1e300", 5, "at most 1e+40"),
    (F, 'law = "tresca"', 5, "tresca needs case.limit"), (F, 'law = "Coulomb"', 5, "did you mean 'coulomb'"),
    (F, f'{F}\nlaw = "frictionless"', 5, "it belongs to case.law coulomb"),
    (D, "divisions = 4", 8, "must be a list of whole numbers"),
    (D, "divisions = [4, 2]", 8, "coarse to fine"), (D, "divisions = [2.5]", 8, "must be an integer"),
    (D, "divisions = [true]", 8, "must be an integer"), (D, "divisions = [1000000]", 8, "1e+12 nodes"),
    (D, f"{D}\nsizes = [1e-2]", 8, "not both"),
    (D, "sizes = [10, 5]", 8, "sizes are in m"), (D, "sizes = [1e-9]", 8, "nodes, at most 5e+06"),
    (D, "sizes = [1e-5]", 8, "nodes, at most 5e+06"), (D, "sizes = [5e-3, 10e-3]", 8, "coarse to fine"),
    (D, "sizes = [1e-2]\ncontact_ratio = 1e9", 8, "nodes, at most"),
    (D, "sizes = [1e-2]\ncontact_ratio = 0.5", 9, "must be >= 1"),
    (D, 'sizes = [1e-2]\ntransfer = "L2"', 9, "did you mean 'l2'"),
    (D, 'transfer = "l2"', 8, "has no meaning for uniform grids"),
    (D, f"{D}\nlevels = 2", 9, "bisect one grid"), (D, "divisions = [2]\nlevels = 99", 9, "<= 30"),
    (D, 'sizes = [1e-2]\nlevels = 2\ntransfer = "l2"', 10, "not nested"),
    (P, "condensed = true", 12, "belongs to single-grid"), (P, 'gap = "largest"', 12, "solver.correction paper"),
    (P, "pre = 2.0", 12, "must be an integer"), (P, "pre = 0", 12, "must not both be 0"),
    (P, "omega = 2.0", 12, "omega"), (P, "rtol = 1", 12, "must be > 0 and < 1"), (P, "coarse.rtol = 2", 12, "rtol"),
    (P, 'linear = "amg"', 12, "solver.linear has no meaning for solver.method multigrid"),
    # what is measured
    (M, 'columns = "cycles"', 15, "must be a list of names"), (M, 'columns = ["max pressure"]', 15, "'max_pressure'"),
    (M, "points = [[0, 0]]", 15, "must be values by name"), (M, "points = {A = [0.0]}", 15, "must have 2 coordinates"),
    (M, "points = {A = 1}", 15, "points.A"), (M, "forces_on = [1]", 15, "must be a list of names"),
    (M, 'forces_on = ["botom"]', 15, "did you mean 'bottom'"), (M, "keep = 1", 15, "must be true or false"),
    # what varies
    (VARIED, "", 17, "or it is empty"), (VARIED, '"case.size" = {a = 1}', 18, "must be a list of values"),
    (VARIED, '"case.size" = 0.2', 18, "must be a list of values, got 0.2"),
    (VARIED, '"case.size" = [0.2, "x"]', 18, "must be a number, got 'x'"),
    (VARIED, '"case.size" = [0.2, nan]', 18, "must be finite"),
    (VARIED, '"case.size" = [0.2, 0.2]', 18, "holds a value twice"),
    (VARIED, '"case.case" = ["greco_bar", "nothing"]', 18, "there is no case 'nothing'"),
    (VARIED, '"case.case" = ["greco_bar", "dovetail"]\n"case.side_pressure" = [1.0]', 19, "no key 'side_pressure'"),
    (VARIED, "\n".join(f'"case.{key}" = {[k / 1000 for k in range(1, 200)]}' for key in ("friction", "size", "young")),
     17, "at most 2000000"),
    # designs
    (V, '[design]\nkind = "sobol"\nruns = 4\nlog = ["x"]\n[vary]', 20, "log names ['x']"),
    (V, '[design]\nkind = "lhs"\n[vary]', 18, "must be one of 'grid'"),
    (V, '[design]\nkind = "sobol"\n[vary]', 18, "needs runs"), (V, "[design]\nruns = 4\n[vary]", 18, "samples"),
    (V, "[design]\nrepeats = 0\n[vary]", 18, "must be >= 1"),
    # load paths, adaptation, how it is run
    (V, "[load_path]\nright = [1.0]\n[vary]", 18, "no load there"),
    (V, "[load_path]\nleft = [1.0, 2.0]\ntop = [1.0]\n[vary]", 18, "same number of steps"),
    (V, "[adapt]\nmax_nodes = 9\n[vary]", 7, "not both"), (V, "[run]\nworkers = 0\n[vary]", 18, "must be >= 1"),
    (V, '[run]\ncost = "x"\n[vary]', 18, "no setting or measure 'x'"),
    (V, '[run]\nscheduler = "tcp://x:1"\n[vary]', 18, "[run] has no key 'scheduler'"),
])
def test_a_wrong_line_is_named(old, new, line, words):
    assert old in GOOD
    text = told(GOOD.replace(old, new, 1))
    assert text.startswith(f"study.toml, line {line}: ") and words in text, text


@pytest.mark.parametrize(("given", "line", "words"), [
    ("start = 5.0\nmax_nodes = 9", 8, "m is more than the body is long"), ("start = 5e-3", 7, "at least one of"),
    ("max_nodes = 0", 8, "max_nodes must be >= 1"),
    ('max_nodes = 9\nindicator = "goal"', 9, "goal needs adapt.quantity"),
    ('max_nodes = 9\nindicator = "goal"\nquantity = "displacement"', 10, "displacement needs adapt.points"),
    ('max_nodes = 9\nquantity = "opening"', 9, "belongs to adapt.indicator goal"),
    ("max_nodes = 9\ncoarsen = 0.1", 9, "belongs to adapt.engine bisect"), ("max_nodes = 9\ntheta = 2", 9, "<= 1"),
])
def test_a_wrong_adaptation_is_named(given, line, words):
    text = told(GOOD.replace(f"[hierarchy]\n{D}", f"[adapt]\n{given}").replace(P, ""))
    assert text.startswith(f"study.toml, line {line}: ") and words in text, text


@pytest.mark.parametrize(("content", "words"), [
    ("", "is empty"), (" \n\n", "is empty"), ("# nothing\n", "there is no section [case]"),
    (bytes(range(256)), "line 2: this is not text in UTF-8"), (GOOD.encode("utf-16"), "not text in UTF-8"),
    (GOOD.replace("bar", "b\xe4r").encode("latin-1"), "line 1: this is not text in UTF-8"),
    (b"#" * 2_000_000, "more than 1000000 bytes"), ('{"case": 1}', "line 1: not TOML"),
    ("a = " + "[" * 9000, "too deep"), ("a = " + "9" * 5000, "too many digits"),
    (f'{GOOD}\nx = "abc', "Unterminated string"),
    (GOOD.replace('"greco_bar"', "\u201cgreco_bar\u201d"), "line 4: not TOML"),
    (GOOD.replace("case = ", "case\u00a0= "), "line 4: not TOML"),
    (GOOD.replace('"greco_bar"', '"\u202egreco"'), "control characters"), (GOOD.replace("\n", "\r"), "not TOML"),
])
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
    for path, words in ((".", "a folder or a device"), ("/dev/zero", "a folder or a device"), ("none.toml", "no such")):
        with pytest.raises((ValueError, OSError), match=words):
            read(path)


def test_a_value_late_in_a_list_is_looked_at_too():
    values = [round(0.001 * k, 3) for k in range(1, 480)]
    text = told(GOOD.replace(VARIED, f'"case.poisson" = {values}\n"case.young" = [1e9, 2e9]').replace("0.479]", "0.5]"))
    assert "line 18: with case.poisson = 0.5" in text
