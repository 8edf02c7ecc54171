"""Sections at once: timed runs wait for all others and go one by one, a failure ends no other, long texts come back."""

from __future__ import annotations

import sys
import threading
import time
from types import ModuleType

import pytest
from study_scripts import load

common, together = load("common"), load("together")


class Runs:
    """Stands for a study: says when it begins and ends."""

    def __init__(self):
        self.seen = []

    def run(self, progress=None, scheduler=None, throw=False):
        kind = "timed" if scheduler is None else "run"
        self.seen.append((kind, "begins"))
        time.sleep(0.05)
        self.seen.append((kind, "ends"))


def in_threads(section, counts):
    threads = [threading.Thread(target=section, args=one) for one in counts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()


def test_timed_runs_wait_for_all_others_and_go_one_by_one():
    runs, turns = Runs(), together.Turns(4, object())

    def section(timed, plain):
        with turns.turn():
            for kind in [False] * plain + [True] * timed:
                turns.run(runs, kind)

    in_threads(section, ((1, 0), (1, 1), (2, 0), (0, 4)))
    assert [kind for kind, _ in runs.seen] == ["run"] * 10 + ["timed"] * 8
    assert [what for _, what in runs.seen[10:]] == ["begins", "ends"] * 4


def test_a_thread_has_its_turn_alone():
    turns, inside, most = together.Turns(3, object()), [], []

    def enter():
        inside.append(1)
        most.append(len(inside))
        time.sleep(0.02)
        inside.pop()

    def section():
        with turns.turn():
            enter()
            with turns.alone():
                enter()

    in_threads(section, [()] * 3)
    assert most == [1] * 6


def test_long_texts_come_back_from_their_files(tmp_path):
    def run(n):
        return {"text": "x" * n, "m": n}

    context = common.Context(True, tmp_path)
    for _ in range(2):
        assert context.study(run, {"n": [3, 100_000]})["text"].str.len().tolist() == [3, 100_000]


@pytest.mark.parametrize("workers", [0, 1])
def test_a_study_that_fails_says_so_and_the_others_go_on(tmp_path, monkeypatch, capsys, workers):
    broken, sound = ModuleType("broken_study"), ModuleType("sound_study")

    def fails(context):
        raise ValueError("no <such> mesh")

    broken.run, sound.run = fails, lambda context: common.Section("Sound", "It is.")
    monkeypatch.setitem(sys.modules, "broken_study", broken)
    monkeypatch.setitem(sys.modules, "sound_study", sound)
    made = {}

    def done(name, section, pictures, seconds):
        made[name] = section.summary or section.text

    names, context = ("broken_study", "sound_study"), common.Context(True, tmp_path)
    ends = together.at_once(context, names, done, workers) if workers else together.in_turn(context, names, done)
    assert ends == ["broken_study"] and made["sound_study"] == "It is."
    assert made["broken_study"] == "This study failed: ValueError: no <such> mesh"
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("count", [0, 1, 2])
def test_an_order_is_fitted_to_three_points_or_more(count):
    x = [1.0, 2.0, 4.0]
    assert common.slope(x, x) == pytest.approx(1.0)
    assert common.slope(x[:count], x[:count]) != common.slope(x[:count], x[:count])
