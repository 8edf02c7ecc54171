"""The points that [vary] and [design] of a study file say."""

from __future__ import annotations

from typing import Any

from adaptmg.study.designs import Design, Grid, LatinHypercube, Random, Repeated, Sobol, Zip

__all__ = ["design_of"]

_SAMPLES = {"random": Random, "latin-hypercube": LatinHypercube, "sobol": Sobol}


def design_of(values: dict[str, list[Any]], kind: str = "grid", repeats: int = 1, **options: Any) -> Design:
    """A design; ValueError or TypeError for what does not fit together.

    Parameters
    ----------
    values : dict of str to list
        Of the settings that vary: their values, or for samples their ranges.
    kind, repeats
        See :mod:`adaptmg.cli.described.keys`.
    options
        The other keys of [design].
    """
    if kind in _SAMPLES:
        if "runs" not in options:
            raise ValueError(f"a {kind} design needs runs = NUMBER, and [low, high] of each setting in [vary]")
        # whole numbers where the setting is one: ends of floats that are written as integers are not
        made: Design = _SAMPLES[kind](values, options.pop("runs"), **options)
    elif options:
        raise ValueError(f"a {kind} design takes no {next(iter(options))}: that belongs to samples, such as kind = "
                         "\"sobol\"")
    else:
        made = Zip(values) if kind == "zip" else Grid(values)
    return made if repeats == 1 else Repeated(made, repeats, name="repeat")
