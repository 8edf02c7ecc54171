"""A result of two bodies made by hand. No NGSolve, no solver."""

import dataclasses

import numpy as np
from made import cube, result_on, square

import adaptmg as am
from adaptmg.discrete.stress import StressData


def joined(parts: dict[str, am.MeshArrays], shifts: dict[str, tuple[float, ...]]) -> am.MeshArrays:
    """Meshes moved and put together body by body; boundaries are named 'body.edge'."""
    return am.mesh.merged(
        {
            body: dataclasses.replace(mesh, points=mesh.points + np.asarray(shifts[body]))
            for body, mesh in parts.items()
        }
    )


STEEL, RUBBER = {"young": 2e11, "poisson": 0.3}, {"young": 1e7, "poisson": 0.45}
MATERIALS = {"upper": am.PlaneStrain(**STEEL), "lower": am.PlaneStrain(**RUBBER)}
SOLIDS = {"upper": am.Solid(**STEEL), "lower": am.Solid(**RUBBER)}


def two_bodies(dim: int = 2, n: int = 8, m: int = 5, size: float = 0.04) -> am.Result:
    """A block on a larger one: open, slip and stick on 'upper.bottom', whose master is a boundary
    of 'lower'."""
    make, wide = (square, 1.5) if dim == 2 else (cube, 1.5)
    upper, lower = make(n, size), make(m, wide * size)
    shift = np.zeros(dim)
    shift[:-1], shift[-1] = -0.25 * size, -wide * size
    mesh = joined({"upper": upper, "lower": lower}, {"upper": (0.0,) * dim, "lower": tuple(shift)})
    single = result_on(upper)
    displacement = np.vstack([single.displacement, 0.0 * lower.points])
    below = np.vstack([upper.points, lower.points + shift])[len(upper.points) :]
    depth = np.exp(below[:, -1] / size)
    displacement[len(upper.points) :, -1] = -1e-5 * depth
    displacement[: len(upper.points), -1] -= 1e-5
    contact = dataclasses.replace(
        single.contact,
        names=("upper.bottom",),
        masters=("lower.top" if dim == 2 else "lower.rest",),
    )
    data = StressData.of(mesh, MATERIALS if dim == 2 else SOLIDS)
    return dataclasses.replace(
        single,
        mesh=mesh,
        displacement=displacement,
        reaction=np.zeros_like(displacement),
        contact=contact,
        problem_name="two blocks",
        stress_data=data,
    )


FACTORS = (0.25, 0.5, 1.0, 0.5)
QUANTITIES = {
    "force [kN]": lambda r: 1e-3 * r.contact.force_n.sum(),
    "slip [µm]": lambda r: 1e6 * r.contact.slip.max(),
}


def steps_of(result: am.Result) -> list[am.Result]:
    """Load steps whose normal forces are those of a result times FACTORS."""
    c = result.contact
    return [
        dataclasses.replace(result, contact=dataclasses.replace(c, force_n=f * c.force_n))
        for f in FACTORS
    ]


def two_solids() -> am.ContactProblem:
    """The problem of two bodies in 3D, to be drawn on their mesh."""
    return am.ContactProblem(
        material={body: am.Solid(**STEEL) for body in ("upper", "lower")},
        law=am.Frictionless(),
        name="two solids with a long name",
        contact=am.ContactPair("upper.bottom", "lower.bottom"),
        supports=(am.Support("lower.rest", z=0),),
        loads=(am.Pressure("upper.rest", 2e7), am.InitialStrain("upper", (0, 0, -1e-3))),
    )
