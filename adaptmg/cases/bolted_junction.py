r"""Bolted junction of two vessels under internal pressure (after Example 3 of the paper): a reconstruction.

The paper gives neither dimensions nor loads; these are ours. Two flanged pipes touch along the plane z = 0 with
Coulomb friction, n bolts on a circle of radius :math:`r_b` press them together, and the internal pressure p acts on the
bores and, through the ends of the closed vessel, as the thrust :math:`p\pi r_i^2` on the upper pipe. The lower pipe is
held axially at its end. Pressure does not creep into the joint where it opens. With the bolt force F the joint carries

.. math:: N = F - p\,\pi r_i^2 .

The bolts are shortened by :math:`\delta` (an initial strain :math:`-\delta/l` over the clamped length l) and load the
joint through their heads,

.. math:: F = \frac{\delta}{c_b + c_m},\qquad c_b = \frac{l}{E\,n A},\qquad c_m = \frac{l}{E\,A_m},

:math:`A_m` being the effective section of flanges, heads and seats, found once from the default geometry.

In axisymmetry (dim = 2) the bolts are an equivalent ring of I-shaped section that lies over the flanges without sharing
nodes: only the undersides of its heads touch them. The section of its shank is that of the n bolts, and so are axial
stiffness and stress. Its Poisson number is 0: a ring under tension would shrink towards the axis of the vessels, which
bolts do not. It also resists hoop strain, which single bolts do not; without friction under the heads (the default in
2D) that does not reach the flanges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adaptmg.cases.flanges import Flanges, bolt_places, bolt_solid, drilled, flange_section, mirrored, ring_section
from adaptmg.problem import (
    Assembly,
    Axisymmetric,
    ContactPair,
    ContactProblem,
    Coulomb,
    Elastic,
    Frictionless,
    InitialStrain,
    Law,
    Polygon,
    Pressure,
    Solid,
    Support,
    Traction,
    checks,
)
from adaptmg.problem.domains import SolidDomain

__all__ = ["BOLTS", "bolted_junction"]

BOLTS = ("ring", "traction", "solid")
_REMARK = ("A reconstruction: the paper gives no dimensions and no loads. The values are our own, by mesh convergence; "
           "nothing published stands behind them.")

# with the default parameters; see the docstring of the case
_VALUES: Mapping[str, Mapping[str, float]] = {
    "ring": {"open_to": 0.2249, "slip_to": 0.2342, "gap": 8.88e-6, "peak": 33.5e6, "peak_at": 0.245,
             "joint_force": 1.985e6, "bolt_force": 2.488e6},
    "traction": {"open_to": 0.2250, "slip_to": 0.2343, "gap": 8.93e-6, "peak": 33.5e6, "peak_at": 0.246,
                 "joint_force": 1.9973e6},
}


@dataclass(frozen=True)
class _Friction:
    """Friction of the joint near z = 0, of the bolts' heads elsewhere; a class, so that problems can be pickled."""

    joint: float
    heads: float
    reach: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.where(np.abs(points[:, -1]) < self.reach, self.joint, self.heads)


def bolted_junction(*, dim: int = 2, bolt: str | None = None, preload: float = 2.5e6, shortening: float | None = None,
                    pressure: float = 4e6, friction: float = 0.2, head_friction: float | None = None,
                    flanges: Flanges | None = None, young: float = 2.1e11, poisson: float = 0.3) -> ContactProblem:
    """Two vessels bolted together, under internal pressure.

    Parameters
    ----------
    dim : {2, 3}
        Axisymmetric, or a sector of 90 degrees between the planes of symmetry y = 0 and x = 0.
    bolt : {"ring", "traction", "solid"}, optional
        The bolts as an equivalent ring (default in 2D), as a given traction on both flanges, or as they are (3D).
    preload : float
        Force of all bolts together without pressure, N: exact as traction, otherwise about.
    shortening : float, optional
        Shortening of the bolts, m, in place of ``preload``.
    pressure : float
        Inside, Pa.
    friction : float
        Between the flanges.
    head_friction : float, optional
        Under the heads; default 0 in 2D, 0.2 in 3D, where nothing else holds the bolts.
    flanges : Flanges, optional
        Dimensions; by default 16 bolts of 24 mm, in 3D 8 bolts of the same section, far enough apart for the joint to
        open between them.
    young, poisson : float
        Pa, and a number.

    Returns
    -------
    ContactProblem
        Bodies ``upper``, ``lower`` and the bolts: ``bolt`` (a ring), or ``bolt0``, ``bolt1``, ... in 3D. Boundaries of
        the flanges: ``joint``, ``rim``, ``face``, ``seat``, ``wall``, ``pipe``, ``bore``; of the bolts ``upper_head``
        and ``lower_head`` (undersides), ``side`` and ``tip``. The first contact pair is the joint.

        ``reference`` holds ``remark``, ``flanges``, ``pressure`` (Pa) and ``thrust`` (N); with the default parameters
        in 2D also ``values`` found by mesh convergence: ``open_to``, ``slip_to``, ``peak_at`` (radii, m), ``gap`` (at
        the bore, m), ``peak`` (Pa), ``joint_force`` and ``bolt_force`` (N; this one of the ring).

    See Also
    --------
    adaptmg.cases.bolted_measures : the load path, bolt force, opening, tightness.

    Notes
    -----
    Tightening first and the pressure afterwards (:func:`~adaptmg.cases.bolted_measures.junction_path`), or both at
    once: with the default parameters the answer is the same to the digits of ``values``.
    """
    checks.choice("dim", dim, (2, 3))
    bolt = {2: "ring", 3: "solid"}[dim] if bolt is None else bolt
    checks.choice("bolt", bolt, BOLTS[:2] if dim == 2 else BOLTS[2:])
    if flanges is None:
        flanges = Flanges() if dim == 2 else Flanges(n_bolts=8, diameter=0.034)
    elif not isinstance(flanges, Flanges):
        raise TypeError(f"flanges must be Flanges, got {flanges!r}")
    preload, pressure = checks.quantity("preload", preload, positive=True), checks.quantity("pressure", pressure)
    material = (Axisymmetric if dim == 2 else Solid)(young=young, poisson=poisson)
    usual = shortening is None and not head_friction and (
        preload, pressure, friction, flanges, young, poisson) == (2.5e6, 4e6, 0.2, Flanges(), 2.1e11, 0.3)
    model = _Model(flanges, material, bolt, _shortening(shortening, preload, bolt, flanges, material), preload)
    return ContactProblem(
        name={"ring": "bolted junction", "traction": "bolted junction, bolts as traction",
              "solid": "bolted junction, sector"}[bolt],
        material=model.materials(),
        domain=Assembly(parts=model.parts),
        contact=model.pairs(),
        law=_law(friction, head_friction, model),
        loads=model.loads(pressure),
        supports=model.supports(),
        reference=_reference(flanges, pressure, _VALUES.get(bolt) if usual else None),
    )


def _shortening(value: float | None, preload: float, bolt: str, flanges: Flanges, material: Elastic) -> float:
    if value is None:
        return flanges.shortening(preload, material.young, material.dim)
    if bolt == "traction":
        raise ValueError("shortening: there are no bolts to shorten with bolt='traction'; give preload")
    return checks.quantity("shortening", value, positive=True)


def _law(friction: float, head_friction: float | None, model: _Model) -> Law:
    friction = checks.nonnegative("friction", friction)
    if model.bolt == "traction":
        if head_friction is not None:
            raise ValueError("head_friction: there are no heads with bolt='traction'")
        return Coulomb(friction) if friction else Frictionless()
    heads = (0.0 if model.dim == 2 else 0.2) if head_friction is None else checks.nonnegative("head_friction",
                                                                                            head_friction)
    if model.dim == 3 and not heads:
        raise ValueError("head_friction must be > 0 in 3D: nothing else holds the bolts sideways, got 0")
    if heads == friction:
        return Coulomb(friction) if friction else Frictionless()
    return Coulomb(_Friction(friction, heads, 0.5 * min(model.flanges.upper, model.flanges.lower)))


def _reference(flanges: Flanges, pressure: float, values: Mapping[str, float] | None) -> Mapping[str, Any]:
    reference: dict[str, Any] = {"remark": _REMARK, "flanges": flanges, "pressure": pressure,
                                 "thrust": flanges.thrust(pressure)}
    if values is not None:
        reference["values"] = dict(values)
        reference["sources"] = {"values": "mesh convergence of this case: contact edges of 1, 0.5 and 0.25 mm"}
    return reference


@dataclass(frozen=True)
class _Model:
    """The parts of the problem."""

    flanges: Flanges
    material: Elastic
    bolt: str
    shortening: float
    preload: float
    parts: Mapping[str, Polygon | SolidDomain] = field(init=False)

    def __post_init__(self) -> None:
        f = self.flanges
        upper, lower = flange_section(f, f.upper, self.bolt), mirrored(flange_section(f, f.lower, self.bolt))
        parts: dict[str, Polygon | SolidDomain] = {"upper": upper, "lower": lower}
        if self.bolt == "ring":
            parts["bolt"] = ring_section(f)
        elif self.bolt == "solid":
            places = bolt_places(f)
            parts = {name: drilled(part, f, places) for name, part in parts.items()}
            parts |= {f"bolt{k}": bolt_solid(f, place) for k, place in enumerate(places)}
        object.__setattr__(self, "parts", parts)

    @property
    def dim(self) -> int:
        return self.material.dim

    @property
    def bolts(self) -> tuple[str, ...]:
        return tuple(name for name in self.parts if name.startswith("bolt"))

    def materials(self) -> Elastic | dict[str, Elastic]:
        if self.bolt != "ring":
            return self.material
        # each bolt contracts towards its own axis, not towards that of the vessels
        ring = Axisymmetric(young=self.material.young, poisson=0.0)
        return {"upper": self.material, "lower": self.material, "bolt": ring}

    def pairs(self) -> tuple[ContactPair, ...]:
        heads = [ContactPair(f"{name}.{side}_head", f"{side}.{'seat' if self.dim == 2 else 'face'}")
                 for name in self.bolts for side in ("upper", "lower")]
        return (ContactPair("upper.joint", "lower.joint"), *heads)

    def loads(self, pressure: float) -> tuple[Pressure | Traction | InitialStrain, ...]:
        f = self.flanges
        wall = math.pi * ((f.bore + f.wall)**2 - f.bore**2)
        inside = tuple(Pressure(f"{side}.bore", pressure) for side in ("upper", "lower"))
        end = Traction("upper.pipe", (0.0,) * (self.dim - 1) + (f.thrust(pressure) / wall,))
        if self.bolt == "traction":
            on_seat = self.preload / (2 * math.pi * f.bolt_circle * f.seat)
            return (*(Pressure(f"{side}.seat", on_seat) for side in ("upper", "lower")), *inside, end)
        strain = (0.0,) * (self.dim - 1) + (-self.shortening / f.clamped,)
        return (*(InitialStrain(name, strain) for name in self.bolts), *inside, end)

    def supports(self) -> tuple[Support, ...]:
        if self.dim == 2:
            return (Support("lower.pipe", y=0.0),)
        planes = [Support(f"{side}.{name}", **{axis: 0.0}) for side in ("upper", "lower")
                  for name, axis in (("start", "y"), ("end", "x"))]
        return (Support("lower.pipe", z=0.0), *planes)
