"""What do friction that depends on pressure and slip, and rough surfaces, cost and change?

    python studies/laws.py [--quick | --full] [--out DIR]

The bar of the paper, pressed and pushed, with friction that falls with the pressure, that falls or
rises with the slip, and on layers of several compliances; each is solved to a relative energy error
of 1e-8, next to the same bar with the coefficients of the result given at the nodes. A nearly rigid
block is dragged to and fro on a surface that wears: its friction has a closed form."""

from dataclasses import replace

import numpy as np
import pandas as pd
from common import Output, chain, drawing, main
from scipy.spatial import cKDTree

import adaptmg as am

COULOMB = am.Coulomb(0.4)
FALLING = am.StateLaw(lambda p, s: 0.1 + 0.5 / (1 + p / 5e7))
RIGID, STIFF, SOFT = (am.NormalCompliance(compliance) for compliance in (0.0, 1e-13, 1e-11))
#: yields at 50 MPa as STIFF does
CURVED = am.NormalCompliance(1e-13 * 5e7 ** (1 / 2), exponent=2)
#: law and layer
VARIANTS = {
    "constant": (COULOMB, RIGID),
    "falls with the pressure": (FALLING, RIGID),
    "falls with the slip": (am.StateLaw(lambda p, s: 0.2 + 0.5 * np.exp(-s / 2e-6)), RIGID),
    "rises with the slip": (am.StateLaw(lambda p, s: 0.7 - 0.5 * np.exp(-s / 2e-6)), RIGID),
    "constant, 1e-13 m/Pa": (COULOMB, STIFF),
    "constant, 1e-11 m/Pa": (COULOMB, SOFT),
    "constant, exponent 2": (COULOMB, CURVED),
    "falls with the pressure, 1e-13 m/Pa": (FALLING, STIFF),
    "falls with the pressure, exponent 2": (FALLING, CURVED),
}


def wearing(pressure: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """Return coefficients that fall from 0.06 towards 0.02 over a slip length of 20 mm."""
    return 0.02 + 0.04 * np.exp(-slip / 2e-2)


def bar(law: am.problem.Law, compliance: am.NormalCompliance, n: int) -> am.Hierarchy:
    """Return grids of the bar on a layer."""
    problem = am.cases.greco_bar(law=law)
    layer = replace(problem.contact[0], compliance=compliance)
    return am.Hierarchy.uniform(replace(problem, contact=layer), divisions=chain(n, 4))


def run(variant: str, n: int) -> dict:
    """Count cycles of a variant, and of the bar with its coefficients given at the nodes."""
    law, layer = VARIANTS[variant]
    method = am.FullMultigrid(rtol=1e-8)
    result = am.solve(bar(law, layer, n), method)
    contact = result.contact
    at = contact.force_n > 0
    friction = np.divide(contact.limit, contact.force_n, out=np.zeros(len(at)), where=at)
    tree = cKDTree(contact.x[at])
    given = am.Coulomb(lambda x: friction[at][tree.query(x)[1]])
    return {
        "variant": variant,
        "least friction": friction[at].min(),
        "pressure": contact.pressure.max() / 1e6,
        "cycles": result.cycles,
        "given": am.solve(bar(given, layer, n), method).cycles,
    }


def study(out: Output) -> None:
    """Count cycles, and drag the block."""
    n = 32 if out.quick else 128
    table = pd.DataFrame([run(variant, n) for variant in VARIANTS])
    out.table(
        "variants",
        table,
        "Laws and layers on the bar of the paper",
        "'given': the same bar with the coefficients of the result given at the nodes.",
        units={"pressure": "MPa"},
        formats={"least friction": ".3f", "pressure": ".1f"},
    )
    block = am.ContactProblem(
        domain=am.Rectangle(width=0.1, height=0.01),
        material=am.PlaneStrain(young=1e12, poisson=0.0),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        law=am.StateLaw(wearing),
        loads=[am.Pressure("top", 1e6)],
        supports=[am.Support("top", x=1e-2, name="drag")],
    )
    places = np.append(np.linspace(0.25, 2, 8), [1.5, 1.0, 0.5, 0.0, -0.5, -1.0, 0.0, 0.5, 1.0])
    grids = am.Hierarchy.uniform(block, divisions=[(10, 1), (20, 2)])
    steps = am.solve_path(grids, am.LoadPath({"drag": places}))
    moves = 1e-2 * np.diff(places, prepend=0.0)
    expected = -np.sign(moves) * 1e5 * wearing(np.zeros(1), np.cumsum(np.abs(moves)))
    forces = np.array([step.resultant("contact").force[0] for step in steps])
    figure, axes = drawing(width=7.2)
    axes.plot(10 * places, expected / 1e3, "-", label="closed form")
    axes.plot(10 * places, forces / 1e3, "o", label="computed")
    axes.set(xlabel="displacement [mm]", ylabel="friction on the block [kN/m]")
    axes.legend()
    out.figure("wear", figure, "A block dragged to and fro on a surface that wears")
    more = (table["cycles"] - table["given"]).max()
    out.check("most cycles more than with given coefficients", more, high=2)
    out.check("error of the friction of the block", np.abs(forces / expected - 1).max(), high=1e-3)


if __name__ == "__main__":
    main(study)
