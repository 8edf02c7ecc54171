"""How do cycles grow with slenderness, contrast of stiffness, friction and Poisson's ratio?

    python studies/flexible.py [--quick | --full] [--out DIR]

A cantilever is clamped at one end, a hundredth of its length above a rigid plane, and pressed down
by three times what lets its tip touch: the simplest clip. A block lies on a block that is 1, 30 or
1000 times softer; the slave is the upper one (a warning says what that costs), or the softer one.
The GRECO bar has friction .3 to 3, or a Poisson's ratio up to .49. All are solved to a relative
energy error of 1e-6 by the default (nested start), by its cycles from zero, and by the active set
method, whose steps of both kinds (interior point, Newton) count."""

import numpy as np
from common import Output, main

import adaptmg as am

STEEL = am.PlaneStrain(young=2.1e11, poisson=0.3)
METHODS = {
    "default": am.FullMultigrid(rtol=1e-6),
    "from zero": am.Multigrid(rtol=1e-6),
    "active set": am.ActiveSet(rtol=1e-6),
}


def cantilever(slenderness: float, levels: int) -> am.Hierarchy:
    """A beam of 1 mm thickness over a plane that begins behind a quarter of its length; friction
    .3."""
    thickness, length, gap = 1e-3, 1e-3 * slenderness, 1e-5 * slenderness
    meshes = []
    for across in 2 ** np.arange(levels):
        cells = int(slenderness * across), int(across)
        mesh = am.mesh.structured(am.Rectangle(width=length, height=thickness), cells)
        x, y = mesh.points[mesh.facets].mean(axis=1).T
        small = 1e-6 * thickness
        place = np.select(
            [x < small, (y < small) & (x > length / 4), y > thickness - small], [0, 1, 2], 3
        )
        meshes.append(
            am.MeshArrays(
                mesh.points, mesh.elements, mesh.facets, place, ("clamp", "foot", "top", "free")
            )
        )
    pressure = 3 * 8 * STEEL.young / (1 - STEEL.poisson**2) * thickness**3 / 12 * gap / length**4
    problem = am.ContactProblem(
        name="cantilever",
        material=STEEL,
        law=am.Coulomb(0.3),
        contact=am.Contact("foot", am.Plane((0.0, -gap), (0.0, 1.0))),
        loads=(am.Pressure("top", pressure),),
        supports=(am.Support("clamp", x=0.0, y=0.0),),
    )
    return am.Hierarchy.from_meshes(problem, meshes)


def blocks(contrast: float, levels: int, sides: str = "given") -> am.Hierarchy:
    """A block on a softer one, meshes that do not match; friction .3."""
    parts = {
        "upper": am.Rectangle(width=0.04, height=0.02),
        "lower": am.Rectangle(width=0.06, height=0.03, origin=(-0.01, -0.03)),
    }
    problem = am.ContactProblem(
        name="blocks",
        domain=am.Assembly(parts=parts),
        law=am.Coulomb(0.3),
        contact=am.ContactPair("upper.bottom", "lower.top", sides=sides),
        material={"upper": STEEL, "lower": am.PlaneStrain(young=2.1e11 / contrast, poisson=0.3)},
        loads=(am.Pressure("upper.top", 1e7), am.Traction("upper.top", (1e6, 0.0))),
        supports=(am.Support("lower.bottom", x=0.0, y=0.0),),
    )
    return am.Hierarchy.graded(problem, [8e-3 / 2**k for k in range(levels)])


def bar(friction: float, levels: int, poisson: float = 0.2) -> am.Hierarchy:
    """The GRECO bar."""
    problem = am.cases.greco_bar(law=am.Coulomb(friction), poisson=poisson)
    return am.Hierarchy.uniform(problem, [4 * 2**k for k in range(levels + 1)])


BODIES = {
    "cantilever, slenderness": cantilever,
    "blocks, upper stiffer by": blocks,
    'the same, sides="auto"': lambda value, levels: blocks(value, levels, "auto"),
    "bar, friction": bar,
    "bar, Poisson's ratio": lambda value, levels: bar(1.0, levels, value),
}
VALUES = {
    "cantilever, slenderness": (6, 24, 48, 96),
    "blocks, upper stiffer by": (1, 30, 1000),
    'the same, sides="auto"': (30, 1000),
    "bar, friction": (0.3, 1, 2, 3),
    "bar, Poisson's ratio": (0.3, 0.45, 0.49),
}


def run(body: str, value: float, levels: int) -> dict:
    """Cycles, or steps, of every method."""
    grids = BODIES[body](value, levels)
    row: dict = {"nodes": grids.finest.n_nodes}
    for name, solver in METHODS.items():
        result = am.solve(grids, solver, throw=False)
        taken = f"{result.cycles} ({result.fallback})" if result.fallback else str(result.cycles)
        row |= {
            name: taken if result.status.ok else result.status.name,
            f"{name}, n": result.cycles,
        }
    return row


def study(out: Output) -> None:
    """Count cycles; the worst of the cantilevers."""
    points = [
        {"body": body, "value": value, "levels": 3 if out.quick else 4}
        for body, values in VALUES.items()
        for value in values
    ]
    table = am.Study(run, points, out.store).run(throw=True)
    out.table(
        "flexible",
        table[["body", "value", "nodes", *METHODS]],
        "Cycles to a relative energy error of 1e-6",
        "Cycles of the default after its nested start and from zero; steps of the active set method."
        + " In brackets: the method that took over."
        * bool(
            table[list(METHODS)]
            .astype(str)
            .apply(lambda texts: texts.str.contains("(", regex=False))
            .any()
            .any()
        ),
        formats={"value": "g"},
    )
    beams = table[table["body"] == "cantilever, slenderness"]
    worst = [int(beams[f"{name}, n"].max()) for name in METHODS]
    out.number(
        "Cantilevers 6 : 1 to 96 : 1, friction 0.3: most cycles to 1e-6; from zero; steps of the active set",
        "; ".join(map(str, worst)),
    )
    out.check("most cycles of the default on cantilevers", worst[0], high=22)
    chosen = table[table["body"] == 'the same, sides="auto"']
    out.check("most cycles with the softer side as slave", int(chosen["default, n"].max()), high=15)


if __name__ == "__main__":
    main(study)
