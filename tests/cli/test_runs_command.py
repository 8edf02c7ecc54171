"""``adaptmg runs`` and ``adaptmg report``: what is read, conditions, files, pages, and what is refused."""

import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from adaptmg.cli import studies
from adaptmg.study import Study
from adaptmg.study.record import Record
from adaptmg.study.store import Store


@pytest.fixture
def command(command):
    """``adaptmg runs``."""
    return partial(command, "runs")


def stored(count: int = 300) -> None:
    """A store of many runs, every tenth failed; the first 150 have the same ``a``."""
    records = [Record(parameters={"a": k // 150, "b": k, "same": "x,y", "case.law": "b"},
                      status="done" if k % 10 else "failed", error="" if k % 10 else "ValueError: ten",
                      results={"m": k / 4, "even": k % 2 == 0, "nothing": None, "nan": float("nan")} if k % 10 else {},
                      seconds=0.5, versions={"python": "3"}, finished=f"2026-01-01T00:00:{k:05}") for k in range(count)]
    Store("s.sqlite").put_all("first", records)


def test_rows_are_limited_and_equal_parameters_left_out(command):
    stored()
    code, out, _ = command("s.sqlite", "--limit", "7")
    assert code == 0 and "... 293 more" in out and len(out.splitlines()) == 10
    # the parameter that is the same in all rows shown, but not in all, is there; those that are the same are not
    assert out.split()[:2] == ["a", "b"] and "same" not in out and "law" not in out
    assert "23 more" in command("s.sqlite", "--limit", "7", "--where", "status == 'failed'")[1]


def test_runs_that_lack_a_parameter_of_others(command):
    store = Store("s.sqlite")
    for given in ({"n": 1}, {"n": 1, "late": 2}, {"n": 1, "late": 3}):
        store.put("first", Record(parameters=given, status="done"))
    lines = [line.split() for line in command("s.sqlite")[1].splitlines()]
    assert lines[0][0] == "late" and [line[0] for line in lines[2:5]] == ["-", "2", "3"]
    rows = json.loads(command("s.sqlite", "--json", "--where", "late > 2")[1])
    assert [row["late"] for row in rows] == [3]


def test_a_table_does_not_load_a_solver(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stored(3)
    code = ("import sys\nfrom adaptmg.cli import main\ntry:\n    main(['runs', 's.sqlite', '--where', 'a == 0'])\n"
            "except SystemExit:\n    pass\n"
            "sys.stderr.write(' '.join(m for m in ('numba', 'ngsolve', 'dask', 'adaptmg.solver.solve') "
            "if m in sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr == "" and "3 runs" in done.stdout


@pytest.mark.parametrize(("where", "found"), [
    ("b == 4", [4]), ("0 < b < 3", [1, 2]), ("even == True and b < 6", [2, 4]), ("same == 'x,y' and b == 3", [3]),
    ("status == 'failed' and b < 20", [0, 10]), ("m != 1 and b < 6", [0, 1, 2, 3, 5]), ("nan < 1", []),
    ("error == 'ValueError: ten' and b < 15", [0, 10]), ("`case.law` == 'a' and tries == 1", [])])
def test_conditions(command, where, found):
    stored(30)
    rows = json.loads(command("s.sqlite", "--json", "--where", where)[1])
    assert [row["b"] for row in rows] == found


@pytest.mark.parametrize(("arguments", "words"), [
    (("--where", "c == 1"), "'c' is not defined; the columns are a, b, case.law, same, m"),
    (("--where", "b"), "not true or false"), (("--where", "b ="), "--where 'b ='"),
    (("--where", "status < 1"), "not supported"), (("--study", "frist"), "did you mean 'first'")])
def test_wrong_questions_are_one_line_and_json_too(command, arguments, words):
    stored(12)
    code, out, err = command("s.sqlite", *arguments)
    assert (code, out) == (2, "") and words in err and err.count("\n") == 1
    code, out, err = command("s.sqlite", "--json", *arguments)
    assert code == 2 and words in json.loads(out)["error"] and err.startswith("adaptmg: ")


def test_json_has_no_nan(command):
    stored(3)
    rows = json.loads(command("s.sqlite", "--json")[1], parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert rows[1]["nan"] is None and rows[0]["m"] is None


def test_several_studies_are_counted_without_reading_them(command, monkeypatch):
    stored(20)
    Study(lambda n: {"m": n}, {"n": [1, 2]}, "s.sqlite", name="second").run(progress=False)
    with monkeypatch.context() as patch:
        patch.setattr(Store, "_record", lambda *_: pytest.fail("runs are read"))
        lines = [line.split() for line in command("s.sqlite")[1].splitlines()]
    assert lines[2][:4] == ["first", "18", "2", "10"] and lines[3][:3] == ["second", "2", "0"]
    code, _, err = command("s.sqlite", "--where", "n == 1")
    assert code == 2 and "give --study, one of first, second" in err


def test_a_damaged_row_is_named(command):
    stored(30)
    store = Store("s.sqlite")
    with store._connection as connection:
        connection.execute("UPDATE runs SET results = '[1]' WHERE parameters LIKE '%\"b\":17,%'")
    for options in ((), ("--where", "b == 3")):
        code, out, err = command("s.sqlite", *options)
        assert (code, out) == (2, "") and "is damaged: the run" in err and '"b":17' in err


def test_csv_is_read_back(command):
    stored(30)
    assert command("s.sqlite", "--to", "t.csv")[0] == 0
    text = pd.read_csv("t.csv")
    assert text["b"].tolist() == list(range(30)) and text["status"].tolist().count("failed") == 3
    assert text["m"].tolist()[1:3] == [0.25, 0.5] and text["m"].isna()[0]
    studies.write(pd.DataFrame({"v": ["\udcff\U0001f600", (1, 2)]}, dtype=object), Path("text.csv"))
    assert pd.read_csv("text.csv")["v"].tolist() == ["\\udcff\U0001f600", "[1, 2]"]
    with pytest.raises(ValueError, match=r"must end in \.csv"):
        studies.ending(Path("t.parquet"))


@pytest.fixture
def report(command):
    """``adaptmg report``: exit code, standard error."""
    return lambda *arguments: command.func("report", *arguments)[::2]


def failed_run(name: str = "first") -> None:
    """Three runs, one of which failed, with texts that a page must escape."""
    def run(n, law):
        if n == 3:
            raise ValueError("three <b>&</b> more")
        return {"m": n * 0.5, "w": 2.0 * n}

    Study(run, {"n": [1, 2, 3], "law": ["<i>"]}, "s.sqlite", name=name).run(progress=False)


def test_a_page_and_its_table_stand_beside_the_store(report):
    failed_run()
    code, err = report("s.sqlite")
    assert code == 0 and "wrote first.html and first.csv" in err
    page = Path("first.html").read_text(encoding="utf-8")
    assert "data:image/svg+xml" in page and "three &lt;b&gt;" in page and "<b>&</b>" not in page
    assert pd.read_csv("first.csv")["m"].dropna().tolist() == [0.5, 1.0]
    assert report("s.sqlite", "--result", "w", "--to", "other.html")[0] == 0
    assert Path("other.html").read_text(encoding="utf-8").count("<img") < page.count("<img")


def test_a_page_says_what_all_runs_share_and_when_they_ran(report):
    store = Store("s.sqlite")
    same = {"case.case": "greco_bar", "h.sizes": (0.01, 5e-3)}
    store.put_all("study", [Record(parameters=same | {"case.friction": k / 2}, status="done", machine="node7",
                                   results={"max_pressure": 1e6 * k, "text": "\udcff"}, commit="c" * 40,
                                   finished=f"2026-01-0{k}T10:00:00") for k in range(1, 4)])
    assert report("s.sqlite")[0] == 0
    page = Path("study.html").read_text(encoding="utf-8")
    for words in ("In all runs case.case = greco_bar; h.sizes = [0.01, 0.005].", "[s]", "node7", "cccccccccccc<",
                  "2026-01-01T10:00 to 2026-01-03T10:00 UTC", r"\udcff"):
        assert words in page, words
    code, err = report("s.sqlite", "--to", "study.csv")
    assert code == 2 and "must be an HTML file" in err


def test_what_cannot_be_shown_is_told(report):
    failed_run()
    assert "no such store" in report("none.sqlite")[1]
    code, err = report("s.sqlite", "--result", "cycles")
    assert code != 0 and "cycles" in err and "Traceback" not in err
    failed_run("second")
    assert "give --study, one of first, second" in report("s.sqlite")[1]
    assert "did you mean 'first'" in report("s.sqlite", "--study", "frist")[1]
