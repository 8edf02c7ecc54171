"""What a run of a study file measures, in words and units. Apart from the functions: words do not make runs stale."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["MEANINGS", "UNITS", "units_of"]

#: name -> what it is, and its unit
MEANINGS: dict[str, tuple[str, str]] = {
    "outcome": ("how the (last) solve ended: CONVERGED, LIMIT, STALLED, CYCLING or DIVERGED; always in the table", ""),
    "cycles": ("cycles, sweeps or Newton steps, of all load steps or meshes", ""),
    "work_units": ("passes over the finest matrix, of all load steps or meshes", ""),
    "start_work_units": ("of these, in the nested start of the last solve", ""),
    "solve_seconds": ("wall time of the last solve, without meshes", "s"),
    "residual": ("natural residual of the contact conditions, relative", ""),
    "error_estimate": ("estimated algebraic error, relative, energy norm", ""),
    "energy_error": ("the same by the certificate, which is computed from the raw matrices", ""),
    "violation": ("the certificate's largest violation of a condition of the problem, relative", ""),
    "estimate": ("estimated discretisation error, relative, energy norm (with [adapt])", ""),
    "rate": ("asymptotic convergence rate of a cycle", ""),
    "steps": ("load steps, or meshes of an adaptive loop; else 1", ""),
    "levels": ("grids", ""),
    "nodes": ("nodes of the finest mesh", ""),
    "contact_nodes": ("of these, nodes that may come into contact", ""),
    "open": ("contact nodes that are open", ""),
    "slip": ("contact nodes that slip", ""),
    "stick": ("contact nodes that stick", ""),
    "contact_area": ("area in contact (plane problems: length)", "m^2 or m"),
    "max_pressure": ("largest contact pressure", "Pa"),
    "max_traction": ("largest friction traction", "Pa"),
    "max_slip": ("largest slip of the last step in contact", "m"),
    "max_gap": ("largest gap of a contact node", "m"),
    "max_displacement": ("largest displacement of a node", "m"),
    "max_von_mises": ("largest von Mises stress of an element", "Pa"),
    "force_x": ("resultant contact force on the body (of pairs: on the slaves), x component; plane problems: per metre",
                "N or N/m"),
    "force_y": ("the same, y component", "N or N/m"),
    "force_z": ("the same, z component (3D alone)", "N or N/m"),
}
#: units by name
UNITS = {name: unit for name, (_, unit) in MEANINGS.items() if unit}


def units_of(columns: Iterable[str]) -> dict[str, str]:
    """Units of the columns of a table of a study file."""
    known = {"seconds": "s", "peak_memory": "bytes", **UNITS}
    return {name: known.get(name, "N or N/m") for name in columns if name in known or name.startswith("force_")}
