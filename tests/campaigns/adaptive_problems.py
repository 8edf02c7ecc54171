"""Random problems and random options for the campaign of adaptive loops.

Part of ``adaptive_campaign.py``. One body and pairs, in the plane, in space and axisymmetric; those of the other
campaigns (:mod:`true_errors`) and what they lack: re-entrant corners, arcs and round faces, stacks of several pairs,
interference fits, laws that vary in space, user-defined laws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from true_errors import random_problem

import adaptmg as am
from adaptmg.estimate import Doerfler, Maximum, Recovery, Remesh, Residual
from adaptmg.mesh import graded

MM = 1e-3
#: drawn from; twice is twice as likely
KINDS = ("block", "block", "block", "notched", "notched", "turned", "turned", "round", "round 3D", "stack", "stack",
         "shrunk", "joint")
#: the first seed of problems with remote contact boundaries, which are adapted by residuals
REMOTE = 5000


@dataclass(frozen=True)
class Fading:
    """A friction coefficient that falls along x; a class, so that problems can be pickled."""

    most: float
    length: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.most * (0.5 + 0.5 * np.cos(np.pi * points[:, 0] / self.length))


@dataclass(frozen=True)
class Sticky:
    """A user-defined law: Coulomb's with an adhesion in shear, Pa."""

    friction: float
    adhesion: float
    forces: Any = None

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Sticky:
        return replace(self, forces=self.adhesion * weights)

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return self.forces, np.full(n_contact, self.friction)


def _law(rng: np.random.Generator, length: float) -> Any:
    friction = float(rng.choice([0.1, 0.3, 0.7, 1.0, 1.5]))
    plain = am.Coulomb(friction)
    return [plain, plain, plain, am.Frictionless(), am.Tresca(float(10 ** rng.uniform(6.5, 7.7))),
            am.Coulomb(Fading(friction, length)), Sticky(friction, 5e6)][rng.integers(7)]


def _material(rng: np.random.Generator, kind: Any = am.PlaneStrain) -> Any:
    return kind(young=float(10 ** rng.uniform(10, 11.5)), poisson=float(rng.uniform(0.1, 0.4)))


def _notched(rng: np.random.Generator) -> am.ContactProblem:
    """An L, or a foot with two re-entrant corners, pressed on a plane or standing on a wider block."""
    a = 40 * MM
    neck, foot = a * float(rng.uniform(0.3, 0.7)), a * float(rng.uniform(0.2, 0.6))
    if rng.random() < 0.5:
        corners = [(0, 0), (a, 0), (a, foot), (neck, foot), (neck, a), (0, a)]
        names = ("bottom", "side", "ledge", "flank", "top", "symmetry")
    else:
        left = 0.5 * (a - neck)
        corners = [(0, 0), (a, 0), (a, foot), (left + neck, foot), (left + neck, a), (left, a), (left, foot), (0, foot)]
        names = ("bottom", "side", "ledge", "flank", "top", "flank2", "ledge2", "symmetry")
    shape = am.Polygon(vertices=corners, boundaries=names)
    push = float(rng.uniform(-0.3, 0.6))
    pressure = float(rng.uniform(1e7, 1e8))
    kind = am.PlaneStress if rng.random() < 0.3 else am.PlaneStrain
    if rng.random() < 0.5:
        return am.ContactProblem(
            name="notched", domain=shape, material=_material(rng, kind), law=_law(rng, a),
            contact=am.Contact("bottom", am.Plane((0, -float(rng.choice([0, 0, 1e-6, 1e-5]))), (0, 1))),
            loads=(am.Traction("top", (push * pressure, -pressure)),), supports=(am.Support("symmetry", x=0.0),))
    under = am.Rectangle(width=1.5 * a, height=0.6 * a, origin=(-0.2 * a, -0.6 * a))
    return am.ContactProblem(
        name="notched on a block", domain=am.Assembly(parts={"upper": shape, "lower": under}), law=_law(rng, a),
        material={"upper": _material(rng, kind), "lower": _material(rng, kind)},
        contact=am.ContactPair("upper.bottom", "lower.top"),
        loads=(am.Traction("upper.top", (push * pressure, -pressure)),),
        supports=(am.Support("upper.symmetry", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)))


def _turned(rng: np.random.Generator) -> am.ContactProblem:
    """Axisymmetric: a cylinder or tube pressed on a plane or on a wider disc."""
    inner = float(rng.choice([0.0, 0.0, 10 * MM]))
    width, height = 20 * MM, float(rng.uniform(15, 40)) * MM
    upper = am.Rectangle(width=width, height=height, origin=(inner, 0.0))
    pressure = float(rng.uniform(1e7, 1e8))
    law = _law(rng, 40 * MM)
    if rng.random() < 0.4:
        supports = (am.Support("left", x=0.0),) if inner == 0 else ()
        return am.ContactProblem(
            name="turned", domain=upper, material=_material(rng, am.Axisymmetric), law=law,
            contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
            loads=(am.Pressure("top", pressure), am.Pressure("right", float(rng.uniform(-0.3, 1)) * pressure)),
            supports=supports)
    lower = am.Rectangle(width=width + inner + 15 * MM, height=20 * MM, origin=(0.0, -20 * MM))
    supports = (am.Support("lower.left", x=0.0), am.Support("lower.bottom", y=0.0))
    if inner == 0:
        supports = (*supports, am.Support("upper.left", x=0.0))
    return am.ContactProblem(name="turned pair", domain=am.Assembly(parts={"upper": upper, "lower": lower}), law=law,
                             material={name: _material(rng, am.Axisymmetric) for name in ("upper", "lower")},
                             contact=am.ContactPair(*(("upper.bottom", "lower.top")
                                                      if rng.random() < 0.6 else ("lower.top", "upper.bottom"))),
                             loads=(am.Pressure("upper.top", pressure),), supports=supports)


def _round(rng: np.random.Generator) -> am.ContactProblem:
    """Half a disc on end (axisymmetric: a dome) pressed on a plane or on a block."""
    radius = 50 * MM
    axisymmetric = bool(rng.random() < 0.3)
    kind = am.Axisymmetric if axisymmetric else am.PlaneStrain
    edge = (radius * math.sin(math.radians(70)), radius * (1 - math.cos(math.radians(70))))
    quarter = am.Outline(vertices=((0, 0), edge, (edge[0], radius), (0, radius)),
                         boundaries=("round", "side", "top", "axis"), arcs={0: (0.0, radius)})
    down = float(10 ** rng.uniform(-5, -3.6))
    law = _law(rng, radius)
    if rng.random() < 0.4:
        return am.ContactProblem(
            name="disc", domain=quarter, material=_material(rng, kind), law=law,
            contact=am.Contact("round", am.Plane((0, 0), (0, 1))),
            supports=(am.Support("axis", x=0.0), am.Support("top", y=-down)))
    # not touching at the point: the closest points of an arc are found to 1e-12 m or so, and overlap is refused
    lower = am.Rectangle(width=radius, height=0.6 * radius, origin=(0.0, -0.6 * radius - 1e-9))
    return am.ContactProblem(
        name="disc on a block", domain=am.Assembly(parts={"upper": quarter, "lower": lower}), law=law,
        material={name: _material(rng, kind) for name in ("upper", "lower")},
        contact=am.ContactPair("upper.round", "lower.top"),
        supports=(am.Support("upper.axis", x=0.0), am.Support("upper.top", y=-down),
                  am.Support("lower.left", x=0.0), am.Support("lower.bottom", y=0.0)))


def _round_3d(rng: np.random.Generator) -> am.ContactProblem:
    """A quarter of a turned pin, pressed on a plane."""
    radius, height = 20 * MM, 25 * MM
    profile = am.Outline(vertices=((0, 0), (0.5 * radius, 0), (radius, 0.5 * radius), (radius, height), (0, height)),
                         boundaries=("bottom", "round", "wall", "top", "axis"), arcs={1: (0.5 * radius, 0.5 * radius)})
    push = float(rng.uniform(-0.2, 0.4))
    pressure = float(rng.uniform(1e7, 5e7))
    law = _law(rng, radius)
    return am.ContactProblem(name="pin", domain=am.Revolution(profile, angle=90.0), material=_material(rng, am.Solid),
                             law=law, contact=am.Contact("bottom", am.Plane((0, 0, 0), (0, 0, 1))),
                             loads=(am.Traction("top", (push * pressure, 0.0, -pressure)),),
                             supports=(am.Support("start", y=0.0), am.Support("end", x=0.0)))


def _stack(rng: np.random.Generator) -> am.ContactProblem:
    """Three blocks on each other: two pairs in a chain; the lowest fixed, or on a rigid plane."""
    sides = [40 * MM, 55 * MM, 70 * MM]
    parts, y = {}, 0.0
    for name, side in zip(("top", "middle", "base"), sides, strict=True):
        height = side * float(rng.uniform(0.3, 0.6))
        y -= height
        parts[name] = am.Rectangle(width=side, height=height, origin=(0.0, y))
    pairs = []
    for upper, lower in (("top", "middle"), ("middle", "base")):
        pair = (f"{upper}.bottom", f"{lower}.top")
        # a surface that is covered in part may be the slave too
        pairs.append(am.ContactPair(*pair[::1 if rng.random() < 0.7 else -1]))
    held: tuple[Any, ...] = (am.Support("base.bottom", x=0.0, y=0.0),)
    if rng.random() < 0.4:
        pairs.append(am.Contact("base.bottom", am.Plane((0.0, y), (0.0, 1.0))))
        held = ()
    pressure = float(rng.uniform(1e7, 1e8))
    return am.ContactProblem(
        name="stack", domain=am.Assembly(parts=parts), material={name: _material(rng) for name in parts},
        contact=tuple(pairs), law=_law(rng, sides[2]),
        loads=(am.Traction("top.top", (float(rng.uniform(-0.2, 0.2)) * pressure, -pressure)),
               am.BodyForce((0.0, -7.8e4), body="middle")),
        supports=(*(am.Support(f"{name}.left", x=0.0) for name in parts), *held))


def _shrunk(rng: np.random.Generator) -> am.ContactProblem:
    """A ring shrunk onto a shaft or hub: interference, axisymmetric."""
    inner = float(rng.choice([0.0, 8 * MM]))
    parts = {"shaft": am.Rectangle(width=20 * MM - inner, height=60 * MM, origin=(inner, -30 * MM)),
             "ring": am.Rectangle(width=15 * MM, height=25 * MM, origin=(20 * MM, -12.5 * MM))}
    supports: tuple[Any, ...] = (am.Support("shaft.bottom", y=0.0),)
    if inner == 0:
        supports = (*supports, am.Support("shaft.left", x=0.0))
    depth = float(rng.uniform(5e-6, 2e-5))
    friction = float(rng.choice([0.1, 0.3, 0.6]))
    material = {name: _material(rng, am.Axisymmetric) for name in parts}
    # a part of what friction bears: a pressure of about .2 E times the relative interference, over 25 of 15 mm
    bears = friction * 0.2 * min(one.young for one in material.values()) * depth / (20 * MM)
    return am.ContactProblem(
        name="shrunk ring", domain=am.Assembly(parts=parts), law=am.Coulomb(friction), material=material,
        contact=am.ContactPair("ring.left", "shaft.right", gap=-depth, allow_interference=True),
        loads=(am.Traction("ring.top", (0.0, -float(rng.uniform(0, 0.7)) * bears)),), supports=supports)


def _joint(rng: np.random.Generator) -> am.ContactProblem:
    """The assemblies of the package, with other parameters."""
    which = rng.integers(3)
    if which == 0:
        return am.cases.dovetail(law=am.Coulomb(float(rng.choice([0.05, 0.2, 0.5]))), angle=float(rng.uniform(35, 65)),
                                 clearance=float(rng.choice([0.0, 0.0, 2e-5])), pull=float(rng.uniform(3e7, 1.5e8)),
                                 clamp=float(rng.uniform(0, 1.5e8)))
    if which == 1:
        return am.cases.bolted_junction(bolt=str(rng.choice(["ring", "traction"])),
                                        preload=float(rng.uniform(2e6, 4e6)), pressure=float(rng.uniform(0, 4e6)),
                                        friction=float(rng.choice([0.0, 0.1, 0.3])))
    return am.cases.flat_punch()


def _block(rng: np.random.Generator) -> am.ContactProblem:
    """As in the other campaigns: a bar or block on an obstacle, a pair in 2D or 3D, perhaps moved by its top."""
    return random_problem(int(rng.integers(10**6)))[1].problem


def _remote(rng: np.random.Generator) -> am.ContactProblem:
    """A body most of whose contact boundary stays far from what it faces: a ball, a cylinder, feet, or steps."""
    width = float(10 ** rng.uniform(-2, -0.7))
    law, pressure = _law(rng, width), float(10 ** rng.uniform(6, 7.5))
    if rng.random() < 0.5:
        turned = bool(rng.random() < 0.5)
        shape = am.Outline(vertices=((0, 0), (width, width), (0, width)), boundaries=("foot0", "top", "symmetry"),
                           arcs={0: (0.0, width)})
        n_feet, material = 1, _material(rng, am.Axisymmetric if turned else am.PlaneStrain)
    else:
        # feet of equal width, with or without arches between them; the first one touches
        n_feet, arch = int(rng.integers(2, 5)), float(rng.choice([0.0, 0.6]))
        gaps = np.concatenate([[0.0], 10 ** rng.uniform(-5, -1, n_feet - 1)])
        top = gaps.max() + width * float(rng.uniform(0.5, 1))
        corners, names = [], []
        for k, gap in enumerate(gaps):
            left, right = k * width, (k + 1 - arch * (k < n_feet - 1)) * width
            corners += [(left, gap), (right, gap)]
            names += [f"foot{k}", f"side{k}"]
            if arch > 0 and k < n_feet - 1:
                corners += [(right, top - 0.4 * width), (left + width, top - 0.4 * width)]
                names += [f"arch{k}", f"inside{k}"]
        shape = am.Polygon(vertices=(*corners, (n_feet * width, top), (0.0, top)),
                           boundaries=(*names, "top", "symmetry"))
        material = _material(rng)
    slide = float(10 ** rng.uniform(-4, -2)) if n_feet > 1 and rng.random() < 0.3 else None
    held, feet = am.Support("symmetry", x=0.0), [f"foot{k}" for k in range(n_feet)]
    if slide is not None:  # the top is moved down and along
        moved = {"supports": (am.Support("top", x=slide, y=-width * float(10 ** rng.uniform(-5, -4))),)}
    else:
        moved = {"supports": (held,), "loads": (am.Pressure("top", pressure),)}
    if rng.random() < 0.7:
        plane = am.Plane((0.0, 0.0), (0.0, 1.0))
        return am.ContactProblem(name="remote", domain=shape, material=material, law=law,
                                 contact=tuple(am.Contact(name, plane) for name in feet), **moved)
    # not touching at a point: the closest points of an arc are found to 1e-7 of its radius, and overlap is refused
    under = am.Rectangle(width=1.5 * n_feet * width, height=width, origin=(0.0, -(1 + 1e-6) * width))
    moved = {name: tuple(replace(one, boundary=f"upper.{one.boundary}") for one in ones)
             for name, ones in moved.items()}
    moved["supports"] += (am.Support("lower.left", x=0.0), am.Support("lower.bottom", y=0.0))
    return am.ContactProblem(name="remote pair", domain=am.Assembly(parts={"upper": shape, "lower": under}), law=law,
                             material={name: material for name in ("upper", "lower")},
                             contact=tuple(am.ContactPair(f"upper.{name}", "lower.top") for name in feet), **moved)


_MAKERS = {"remote": _remote, "block": _block, "notched": _notched, "turned": _turned, "round": _round,
           "round 3D": _round_3d, "stack": _stack, "shrunk": _shrunk, "joint": _joint}


@dataclass(frozen=True)
class Loop:
    """A problem, and how it is adapted."""

    kind: str
    problem: am.ContactProblem
    start: Any
    indicator: Any
    mark: Any
    engine: Any
    max_nodes: int

    def steps(self, **more: Any) -> Any:
        """A new loop each time."""
        return am.adapt(self.problem, self.start, self.indicator, self.mark, self.engine, max_nodes=self.max_nodes,
                        **more)


def random_loop(seed: int) -> Loop:
    """A random problem and random options; from the seed ``REMOTE`` on with remote contact boundaries."""
    rng = np.random.default_rng((seed, 11))
    kind = str(KINDS[rng.integers(len(KINDS))]) if seed < REMOTE else "remote"
    problem = _MAKERS[kind](rng)
    dim = problem.dim
    domain = problem.domain
    parts = domain.parts.values() if isinstance(domain, am.Assembly) else (domain,)
    # so that the smallest body has an element or a few across
    across = min(float((part.upper - part.lower).min()) for part in parts)
    start: Any = across / float(rng.uniform(1, 3)) if dim == 2 else across / float(rng.uniform(0.8, 1.6))
    start = _fine_enough(problem, start)
    mark = [Doerfler(0.5), Doerfler(float(rng.uniform(0.2, 0.9))), Maximum(float(rng.uniform(0.1, 0.7)))
            ][rng.choice(3, p=[0.5, 0.3, 0.2])]
    engine = [Remesh(), Remesh(growth=float(rng.uniform(1.6, 4)), refinements=int(rng.integers(3))), am.Bisect(),
              am.Bisect(coarsen=0.02), am.Bisect(passes=1)][rng.choice(5, p=[0.3, 0.2, 0.3, 0.1, 0.1])]
    indicator = [Residual(), Recovery(), None][rng.choice(3, p=[0.35, 0.25, 0.4]) if kind != "remote" else 0]
    if indicator is None:
        indicator = am.Goal(random_quantity(problem, rng))
    most = int(rng.integers(1500, 5000 if dim == 2 else 3500))
    return Loop(kind, problem, start, indicator, mark, engine, most)


def _fine_enough(problem: am.ContactProblem, start: float) -> Any:
    """The size, or half or a quarter of it, where contact has the nodes it needs; or a mesh that is graded to it."""
    for size in (start, start / 2, start / 4):
        try:
            am.Hierarchy.graded(problem, (size,))
        except ValueError as error:
            if "too coarse" not in str(error):
                break
        else:
            return size
    return graded(problem.domain, start, problem.pair_boundaries, 100 if problem.name == "flat punch" else 20)


def random_quantity(problem: am.ContactProblem, rng: np.random.Generator) -> Any:
    """One of each kind of quantity."""
    axis = "xyz"[int(rng.integers(problem.dim))]
    slave = problem.contact_boundaries[int(rng.integers(len(problem.contact_boundaries)))]
    which = rng.integers(4)
    if which == 0:
        domain = problem.domain
        name = None
        if isinstance(domain, am.Assembly):
            name = str(rng.choice(list(domain.parts)))
            domain = domain.parts[name]
        return am.Displacement(_inside(domain, rng), axis, body=name)
    if which == 1:
        loaded = [load.boundary for load in problem.loads if hasattr(load, "boundary")] or [slave]
        return am.MeanDisplacement(str(rng.choice(loaded)), axis)
    if which == 2:
        ways = ["normal", "tangential", axis] if problem.dim == 2 else ["normal", axis]
        return am.ContactForce(slave, str(rng.choice(ways)))
    return am.Opening(slave)


def _inside(domain: Any, rng: np.random.Generator) -> tuple[float, ...]:
    """A point of a body: of what all shapes here contain."""
    share = rng.uniform(0.05, 0.25, domain.dim)
    if isinstance(domain, am.Revolution):
        share = share * 0.5 + 0.1
    point = domain.lower + share * (domain.upper - domain.lower)
    if isinstance(domain, am.Outline):  # a quarter disc is full at its top
        point[1] = domain.upper[1] - share[1] * (domain.upper[1] - domain.lower[1])
    if isinstance(domain, am.Polygon) and not math.isclose(domain.lower[0], 0.0):
        point = np.mean(np.array(domain.vertices), axis=0)
    return tuple(float(c) for c in point)
