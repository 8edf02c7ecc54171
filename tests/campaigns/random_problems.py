"""Random bodies and blocks for the campaigns: obstacles and pairs, 2D and 3D, nested and
independent meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import adaptmg as am

SIDE = 40e-3


@dataclass(frozen=True)
class Wave:
    """A gap that undulates; a class, so that problems can be pickled."""

    amplitude: float
    waves: float
    phase: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Gaps (n,), m."""
        angle = 2 * np.pi * self.waves * points / 40e-3
        height = np.sin(angle[:, 0] + self.phase)
        if points.shape[1] == 3:
            height = height * np.cos(angle[:, 1])
        return self.amplitude * (1 + height)


def random_grids(seed: int) -> am.Hierarchy:
    """A random problem on random meshes."""
    rng = np.random.default_rng(seed)
    dim = 3 if rng.random() < 0.35 else 2
    friction = float(rng.choice([0.1, 0.3, 0.7, 1.0, 1.5, 2.0]))
    coulomb = am.Coulomb(friction)
    law = [
        coulomb,
        coulomb,
        coulomb,
        am.Tresca(float(10 ** rng.uniform(6.5, 8))),
        am.Frictionless(),
    ][rng.integers(5)]
    loads = {
        "top_pressure": float(rng.uniform(1e7, 1e8)),
        "side_pressure": float(rng.uniform(-1e8, 4e8)),
    }
    if dim == 2:
        problem = am.cases.greco_bar(law=law, **loads)
    else:
        problem = am.cases.greco_block(law=law, plane_strain=bool(rng.random() < 0.3), **loads)
    amplitude = float(rng.choice([0, 0, 1e-6, 1e-5, 5e-5]))
    if amplitude > 0:
        wave = Wave(amplitude, float(rng.uniform(0.5, 3)), float(rng.uniform(0, 2 * np.pi)))
        problem = replace(problem, contact=am.Contact("bottom", am.GapFunction(wave)), reference={})
    if rng.random() < 0.5:
        shear = am.Traction("top", (*(float(t) for t in rng.uniform(-5e7, 5e7, dim - 1)), 0.0))
        problem = replace(problem, loads=(*problem.loads, shear), reference={})
    nested = bool(rng.random() < 2 / 3)
    if rng.random() < 0.15:
        # held by contact alone: the side pressure acts on both sides, up to a part that friction
        # can take
        balance = am.Pressure(
            "right", loads["side_pressure"] - float(rng.uniform(0, 0.05)) * loads["top_pressure"]
        )
        problem = replace(problem, supports=(), loads=(*problem.loads, balance), reference={})
    if nested:
        chains = (
            [(4, 8, 16, 32), (4, 8, 16, 32, 64), (3, 6, 12, 24, 48)]
            if dim == 2
            else [(2, 4, 8), (2, 4, 8, 16), (3, 6, 12)]
        )
        return am.Hierarchy.uniform(problem, chains[rng.integers(3)])
    sizes = (16e-3, 8e-3, 4e-3, 2e-3) if dim == 2 else (20e-3, 10e-3, 5e-3)
    return am.Hierarchy.graded(problem, sizes, float(rng.choice([1, 2, 4])))


def random_pair(seed: int) -> am.Hierarchy:
    """A random problem of two bodies on random meshes."""
    rng = np.random.default_rng(seed)
    width = SIDE * float(rng.uniform(1.1, 2))
    height = SIDE * float(rng.uniform(0.4, 1.2))
    left = -float(rng.uniform(0.05, 0.9)) * (width - SIDE)
    parts = {
        "upper": am.Rectangle(width=SIDE, height=SIDE),
        "lower": am.Rectangle(width=width, height=height, origin=(left, -height)),
    }
    friction = float(rng.choice([0.0, 0.1, 0.3, 0.7, 1.0, 1.5]))
    law = am.Coulomb(friction) if friction else am.Frictionless()
    if rng.random() < 0.2:
        law = am.Tresca(float(10 ** rng.uniform(6.5, 8)))
    young = {name: float(10 ** rng.uniform(10, 11.5)) for name in parts}
    slave = "upper" if rng.random() < 0.5 else "lower"
    faces = ("upper.bottom", "lower.top")
    problem = am.ContactProblem(
        name="two bodies",
        domain=am.Assembly(parts=parts),
        law=law,
        material={name: am.PlaneStrain(young=value, poisson=0.3) for name, value in young.items()},
        contact=am.ContactPair(*(faces if slave == "upper" else faces[::-1])),
        loads=(
            am.Pressure("upper.top", float(rng.uniform(1e7, 1e8))),
            am.Pressure("upper.left", float(rng.uniform(-1e8, 2e8))),
        ),
        supports=(am.Support("upper.right", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)),
    )
    nested = bool(rng.random() < 0.5)
    ratio = float(rng.uniform(0.7, 1.5))
    if nested:
        # cells of the lower body about square, larger or smaller than those of the upper one
        n = int(rng.integers(3, 6))
        across, up = (max(1, round(n * length / SIDE * ratio)) for length in (width, height))
        return am.Hierarchy.from_meshes(
            problem,
            [
                am.mesh.merged(
                    {
                        "upper": am.mesh.structured(parts["upper"], n * k),
                        "lower": am.mesh.structured(parts["lower"], (across * k, up * k)),
                    }
                )
                for k in (1, 2, 4, 8)
            ],
        )
    sizes = [{"upper": h, "lower": h * ratio} for h in (9e-3, 5.4e-3, 3.2e-3, 1.9e-3)]
    return am.Hierarchy.graded(problem, sizes, float(rng.uniform(1, 4)))


def random_problem(seed: int) -> am.Hierarchy:
    """A random problem on random meshes."""
    rng = np.random.default_rng((seed, 7))
    kind = ["one body", "one body", "pair", "pair", "pair in 3D"][rng.integers(5)]
    if kind == "pair in 3D":
        return _pair_in_3d(rng)
    return random_grids(seed) if kind == "one body" else random_pair(seed)


def random_rubber(seed: int) -> am.Hierarchy:
    """A random problem with smoothed elements and Poisson's ratios from .4 to .5, of some pairs of
    one body alone."""
    rng = np.random.default_rng((seed, 33))
    grids = random_problem(seed)
    if grids.problem.dim == 3 and grids.finest.n_nodes > 1500:  # factors of the exact solution
        grids = grids.truncated(finest=len(grids) - 2)

    def soft(material: am.PlaneStrain) -> am.PlaneStrain:
        ratios = rng.uniform(0.4, 0.5), 0.5 - 10 ** rng.uniform(-6, -1.2), 0.4999, 0.5
        return replace(material, poisson=float(rng.choice(ratios)))

    own = grids.problem.material
    if isinstance(own, dict):
        own = {name: soft(one) if rng.random() < 0.75 else one for name, one in own.items()}
    else:
        own = soft(own)
    return grids.with_problem(
        replace(grids.problem, material=own, elements="smoothed", reference={})
    )


def _pair_in_3d(rng: np.random.Generator) -> am.Hierarchy:
    """A block on a wider one, meshes that do not match."""
    width = SIDE * float(rng.uniform(1.2, 1.8))
    parts = {
        "upper": am.Box(width=SIDE, depth=SIDE, height=0.6 * SIDE),
        "lower": am.Box(
            width=width,
            depth=width,
            height=0.6 * SIDE,
            origin=(-0.3 * (width - SIDE), -0.6 * (width - SIDE), -0.6 * SIDE),
        ),
    }
    young = {name: float(10 ** rng.uniform(10, 11.5)) for name in parts}
    friction = float(rng.choice([0.0, 0.1, 0.3, 0.7]))
    slave = "upper" if rng.random() < 0.5 else "lower"
    faces = ("upper.bottom", "lower.top")
    problem = am.ContactProblem(
        name="two boxes",
        domain=am.Assembly(parts=parts),
        contact=am.ContactPair(*faces[:: 1 if slave == "upper" else -1]),
        material={name: am.Solid(young=value, poisson=0.3) for name, value in young.items()},
        law=am.Coulomb(friction) if friction else am.Frictionless(),
        loads=(
            am.Pressure("upper.top", float(rng.uniform(1e7, 1e8))),
            am.Pressure("upper.left", float(rng.uniform(-2e7, 5e7))),
        ),
        supports=(
            am.Support("upper.right", x=0.0),
            am.Support("upper.front", y=0.0),
            am.Support("lower.bottom", x=0.0, y=0.0, z=0.0),
        ),
    )
    cells = int(rng.integers(2, 4))
    other = max(1, cells + int(rng.integers(-1, 2)))
    return am.Hierarchy.uniform(
        problem,
        [
            {"upper": (cells * k, cells * k, cells * k), "lower": (other * k, other * k, other * k)}
            for k in (1, 2)
        ],
    )


def random_floating(seed: int) -> am.Hierarchy:
    """A random body that nothing but contact holds, heated or not: rings and blocks on a plane,
    blocks on blocks."""
    rng = np.random.default_rng((seed, 18))
    kind, dim = str(rng.choice(["ring", "block", "pair", "block in 3D"])), 2
    side, ratio, pressure = (
        float(10 ** rng.uniform(-3, 0)),
        float(rng.uniform(0.3, 3)),
        float(10 ** rng.uniform(5, 8)),
    )
    friction = float(rng.choice([0.1, 0.3, 0.7, 1.0]))
    law = (
        am.Coulomb(friction)
        if rng.random() < 0.7 or kind.startswith("block")
        else am.Frictionless()
    )
    gap = side * float(rng.choice([0.0, 10 ** rng.uniform(-7, -3)]))
    loads, supports = [am.Pressure("top", pressure)], ()
    if kind == "ring":
        material = am.Axisymmetric(young=2e11, poisson=0.3)
        domain = am.Rectangle(
            width=side, height=ratio * side, origin=(side * float(rng.uniform(0.1, 3)), 0.0)
        )
        loads.append(am.Pressure("right", pressure * float(rng.uniform(-0.5, 3))))
    elif kind == "block":
        material, domain = (
            am.PlaneStrain(young=2e11, poisson=0.3),
            am.Rectangle(width=side, height=ratio * side),
        )
        push = pressure * float(rng.uniform(-1, 3))
        held = push + 0.1 * friction * pressure * float(rng.uniform(-1, 1))
        loads += [am.Pressure("left", push), am.Pressure("right", held)]
    elif kind == "block in 3D":
        material, dim = am.Solid(young=2e11, poisson=0.3), 3
        domain = am.Box(width=side, depth=side, height=ratio * side)
    else:
        material = {
            name: am.PlaneStrain(young=float(10 ** rng.uniform(10, 11.5)), poisson=0.3)
            for name in "ab"
        }
        domain = am.Assembly(
            parts={
                "a": am.Rectangle(width=side, height=0.3 * side, origin=(0.0, gap)),
                "b": am.Rectangle(width=side, height=0.3 * side, origin=(0.0, -0.3 * side)),
            }
        )
        loads, supports = (
            [am.Pressure("a.top", pressure)],
            (
                am.Support("b.bottom", x=0.0, y=0.0),
                am.PointSupport((0.5 * side, 0.3 * side + gap), x=0.0),
            ),
        )
    if rng.random() < 0.5:
        heat = float(10 ** rng.uniform(-6, -3))
        loads.append(am.InitialStrain("a" if kind == "pair" else "body", (heat,) * 3))
    flat = am.Plane(point=(0.0,) * (dim - 1) + (-gap,), normal=(0.0,) * (dim - 1) + (1.0,))
    contact = (
        am.ContactPair("a.bottom", "b.top", gap=gap)
        if kind == "pair"
        else am.Contact("bottom", flat)
    )
    problem = am.ContactProblem(
        name=kind,
        domain=domain,
        material=material,
        law=law,
        contact=contact,
        loads=tuple(loads),
        supports=supports,
    )
    n = int(rng.integers(2, 5))
    if kind == "pair" or (dim == 2 and rng.random() < 0.5):
        return am.Hierarchy.graded(
            problem, [side * h for h in (0.3, 0.16, 0.08, 0.05)], float(rng.uniform(1, 3))
        )
    return am.Hierarchy.uniform(problem, [n * 2**k for k in range(4 if dim == 2 else 2)])
