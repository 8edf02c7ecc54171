"""Tables 2 and 3 of the paper for its assemblies: smoothings, and zero against full start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from common import Context, Table
from paper_runs import CHANGE, COUNT, RTOL, TARGET, listed, table


def smoothing_table(context: Context, run: Callable[..., dict[str, Any]], counts: Sequence[tuple[int, int]],
                    name: str, fixed: dict[str, Any]) -> Table:
    """Table 2: how many smoothings; ``run`` takes counts, stop and rtol beside what is fixed."""
    frame = context.study(run, {"counts": counts}, stop="error", rtol=RTOL, **fixed)
    own = context.study(run, {"counts": counts}, stop="change", rtol=CHANGE, **fixed)
    pre, post = zip(*counts, strict=True)
    frame = frame.assign(pre=pre, post=post, test=f"error {RTOL:g}", **{"cycles, paper's test": own["cycles"],
                                                                        "its error": own["true_error"]})
    reached = frame.dropna(subset="work_at")
    note = (f"The paper's test is the change over a cycle, relative, at most {CHANGE:g}; 'its error' is the true error "
            "where it stops.")
    if len(reached):
        least = reached.loc[reached["work_at"].idxmin()]
        note = f"Least work at {least['pre']} + {least['post']} smoothings. " + note
    return table(f"{name.split()[0]}_smoothing", frame,
                 ["pre", "post", "grids", "cycles_at", "work_at", "seconds_at", "rate", "cycles, paper's test",
                  "its error", "test", "true_error", "residual", "outcome"],
                 f"Table 2 on the {name}: two grids, monotone mode, full start; cycles and work to a true error of "
                 f"{TARGET:g} against the smoothings before and after the correction", note,
                 {"pre": "d", "post": "d", "cycles, paper's test": "d", "its error": ".1e"})


def start_table(context: Context, run: Callable[..., dict[str, Any]], name: str, fixed: dict[str, Any],
                remark: str = "") -> Table:
    """Table 3: the full start; ``run`` takes correction, full, levels and rtol beside what is fixed."""
    frames = []
    for levels in (3,) if context.quick else (2, 4):
        frame = context.study(run, {"correction": ("monotone", "truncated"), "full": (False, True)}, levels=levels,
                              rtol=RTOL, **fixed)
        frames.append(frame.assign(mode=[f"{COUNT[levels]}, {kind}" for kind in frame["correction"]]))
    frame = pd.concat(frames, ignore_index=True)
    zero = frame[~frame["full"]].set_index("mode")["work_at"]
    frame = frame.assign(start=np.where(frame["full"], "full", "zero"), test=f"error {RTOL:g}",
                         **{"zero over full": np.where(frame["full"], frame["mode"].map(zero) / frame["work_at"],
                                                       np.nan)})
    gains = frame[frame["full"]].dropna(subset="zero over full")
    note = ("What a start from zero costs over the full start: "
            + listed([f"{value:.2f} ({mode})" for mode, value in zip(gains["mode"], gains["zero over full"],
                                                                     strict=True)])
            + f"; the paper: 2.1 for two grids on the bar. {remark}").rstrip()
    return table(f"{name.split()[0]}_start", frame, ["mode", "start", "grids", "start_work", "cycles_at", "work_at",
                                                     "zero over full", "seconds_at", "test", "true_error", "residual",
                                                     "outcome"],
                 f"Table 3 on the {name}: zero and full start, work to a true error of {TARGET:g}", note,
                 {"zero over full": ".2f"})
