"""Units of tables, pictures and reports. Everything inside is in SI units; they change here alone."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from adaptmg import _checks as checks

if TYPE_CHECKING:
    import pandas


class _System(NamedTuple):
    """A system of units: factors of lengths in m and of forces in N, and names of units."""

    length: float
    force: float
    names: Mapping[str, str]


#: exponents of length and force of what is converted
_POWERS = {
    "m": (1, 0),
    "m^2": (2, 0),
    "m/s": (1, 0),
    "N": (0, 1),
    "N/m": (-1, 1),
    "N m": (1, 1),
    "Pa": (-2, 1),
    "J": (1, 1),
    "J/m": (0, 1),
}
#: exact: an inch is 25.4 mm, a pound-force the weight of .45359237 kg at 9.80665 m/s^2 (NIST Special Publication 811,
#: appendix B, doi:10.6028/NIST.SP.811e2008)
SYSTEMS = {
    "SI": _System(1.0, 1.0, {}),
    "mm-MPa": _System(
        1e3,
        1.0,
        {
            "m": "mm",
            "m^2": "mm^2",
            "m/s": "mm/s",
            "N/m": "N/mm",
            "N m": "N mm",
            "Pa": "MPa",
            "J": "mJ",
            "J/m": "mJ/mm",
        },
    ),
    "in-psi": _System(
        1 / 0.0254,
        1 / 4.4482216152605,
        {
            "m": "in",
            "m^2": "in^2",
            "m/s": "in/s",
            "N": "lbf",
            "N/m": "lbf/in",
            "N m": "lbf in",
            "Pa": "psi",
            "J": "lbf in",
            "J/m": "lbf",
        },
    ),
}
_HEAD = re.compile(r"(.*) \[(.+)\]")
#: a number, not the name of a body, before " m,"
_LENGTH = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[+-]\d+)?(?![\w.:])(?=.* m,)")


class _Chosen:
    """The system that tables, pictures and reports have where none is given."""

    name = "SI"


def set_units(units: str) -> None:
    """Set the units of tables, pictures and reports in this process; arrays stay in SI units.

    Parameters
    ----------
    units : {"SI", "mm-MPa", "in-psi"}
        "SI": m, N, Pa, with prefixes in pictures; "mm-MPa": mm, N, MPa; "in-psi": inch, lbf, psi.
        A single table takes others: ``result.contact.table(units="mm-MPa")``.

    Examples
    --------
    >>> am.set_units("mm-MPa")
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> result.contact.table().columns[-2:].tolist()
    ['pressure [MPa]', 'traction [MPa]']
    >>> am.set_units("SI")
    """
    _Chosen.name = checks.choice("units", units, SYSTEMS)


def converted(unit: str, units: str | None = None) -> tuple[float, str]:
    """Return the factor and the name of an SI unit in a system, by default the one that is set;
    other units stay."""
    system = SYSTEMS[checks.choice("units", _Chosen.name if units is None else units, SYSTEMS)]
    length, force = _POWERS.get(unit, (0, 0))
    return system.length**length * system.force**force, system.names.get(unit, unit)


def lengths_in_units(text: str) -> str:
    """Return a text of the package in which lengths, the numbers before " m,", are converted."""
    factor, unit = converted("m")
    numbers = _LENGTH.sub(lambda found: f"{factor * float(found[0]):.6g}", text)
    return numbers.replace(" m,", f" {unit},")


def with_prefixes() -> bool:
    """Return whether pictures choose prefixes: in SI units."""
    return _Chosen.name == "SI"


def with_units(
    table: pandas.DataFrame, units: Mapping[str, str]
) -> tuple[pandas.DataFrame, dict[str, str]]:
    """Return a table whose columns with SI units are converted, and the units that they have."""
    shown = table.copy()
    names = {}
    for name, unit in units.items():
        factor, names[name] = converted(unit)
        if factor != 1.0:
            shown[name] = factor * shown[name]
    return shown, names


def in_units(table: pandas.DataFrame, units: str | None = None) -> pandas.DataFrame:
    """Return a table whose columns "name [SI unit]" are converted."""
    columns = {}
    for head, values in table.items():
        parts = _HEAD.fullmatch(str(head))
        if parts is None:
            columns[head] = values
            continue
        factor, unit = converted(parts[2], units)
        columns[f"{parts[1]} [{unit}]"] = values if factor == 1.0 else factor * values
    return type(table)(columns, index=table.index)
