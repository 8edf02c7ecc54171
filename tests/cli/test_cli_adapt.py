"""``adaptmg adapt``: a line a step, JSON, files, a store to go on from; bad input is a line and exit code 2."""

from __future__ import annotations

import json

import pytest

import adaptmg as am

SMALL = ("adapt", "upset_block", "--start", "8e-3", "--engine", "bisect", "--max-nodes", "120")


def test_a_line_a_step_and_a_tolerance_that_ends_it(command):
    code, out, err = command(*SMALL)
    lines = out.splitlines()
    assert (code, err) == (0, "") and lines[0] == am.Step.HEADER
    numbers = [int(line.split()[0]) for line in lines[1:lines.index("")] if line.split()[0].isdigit()]
    assert numbers == list(range(len(numbers))) and len(numbers) > 1 and "max_nodes" in out and "CONVERGED" in out
    said = json.loads(command(*SMALL[:-2], "--tolerance", "0.1", "--json")[1])
    assert said["steps"][-1]["estimate"] <= 0.1 and "tolerance" in said["outcome"]


@pytest.mark.parametrize("options", [("--engine", "remesh", "--indicator", "recovery"),
                                     ("--theta", "0.3", "--friction", "0.2"), ("--max-seconds", "0.001")])
def test_json_says_what_the_loop_did(command, options):
    code, out, _ = command(*SMALL, *options, "--json")
    said = json.loads(out)
    assert code == 0 and said["outcome"] and said["steps"][0]["step"] == 0
    assert all(row["estimate"] > 0 and row["levels"][-1] == row["nodes"] for row in said["steps"])
    assert said["result"]["status"] == "CONVERGED"
    assert sum(said["steps"][0]["terms"].values()) == pytest.approx(said["steps"][0]["estimate_total"] ** 2)


def test_files_are_written_and_a_store_is_gone_on_from(command, tmp_path):
    store = ("--store", str(tmp_path / "store"))
    first = json.loads(command(*SMALL, *store, "--json")[1])
    code, out, _ = command(*SMALL, *store, "--out", str(tmp_path / "out"), "--json")
    again = json.loads(out)
    assert code == 0 and again["steps"] == first["steps"]
    names = {file.name for file in (tmp_path / "out").iterdir()}
    assert {"adaptation.png", "result.npz", "result.vtu"} <= names
    code, _, err = command(*SMALL, *store, "--theta", "0.3")
    assert code == 2 and "another run: value of mark differs" in err


def test_a_mesh_that_is_not_solved_ends_with_code_1(command, monkeypatch):
    from adaptmg.estimate import loop

    result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8)),
                      am.FullMultigrid(max_cycles=1), throw=False)
    monkeypatch.setattr(loop.AdaptiveLoop, "steps", lambda self: (_ for _ in ()).throw(am.NotConverged(result)))
    code, out, err = command(*SMALL, "--json")
    assert code == 1 and "not converged" in json.loads(out)["error"] and "not converged: " in err.splitlines()[-1]


@pytest.mark.parametrize("options, words", [(("--max-nodes", "0"), "max_nodes"), (("--start", "-1"), "start"),
                                            (("--theta", "2"), "theta"), (("--tolerance", "nan"), "tolerance"),
                                            (("--limit", "3", "--friction", "1"), "limit")])
def test_bad_input_is_a_line(command, options, words):
    code, out, err = command(*SMALL, *options)
    assert (code, out) == (2, "") and words in err and len(err.splitlines()) == 1
