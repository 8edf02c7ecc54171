"""ContactProblem: an elastic body, its loads and supports, and the obstacle it may touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from adaptmg.problem import checks
from adaptmg.problem.domains import Box, Domain, Polygon, Rectangle
from adaptmg.problem.laws import Law
from adaptmg.problem.loads import BodyForce, Pressure, Support, Traction
from adaptmg.problem.materials import Elastic
from adaptmg.problem.obstacles import GapFunction, Plane

__all__ = ["Contact", "ContactProblem"]


@dataclass(frozen=True, eq=False)
class Contact:
    """A boundary that may touch a rigid obstacle.

    Parameters
    ----------
    boundary : str
        Name of the contact boundary.
    obstacle : Plane or GapFunction
        What it may touch.
    allow_interference : bool
        Accept negative initial gaps (an interference fit).
    """

    boundary: str
    obstacle: Plane | GapFunction
    allow_interference: bool = False

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        if isinstance(self.obstacle, type) or not hasattr(self.obstacle, "contact"):
            raise TypeError(f"obstacle must be a Plane or a GapFunction, got {self.obstacle!r}")


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactProblem:
    """What is posed; pure data in SI units, no mesh.

    Parameters
    ----------
    material : PlaneStrain, PlaneStress or Solid
        The elastic body.
    contact : Contact or sequence of Contact
        The boundaries that may touch a rigid obstacle.
    law : Frictionless, Tresca, Coulomb or one's own
        The contact law, the same on all contact boundaries (its parameters may vary in space).
    loads : sequence of Pressure, Traction, BodyForce
        What acts on the body.
    supports : sequence of Support
        Prescribed displacement components.
    domain : Rectangle, Box, Polygon, optional
        The geometry; not needed when every mesh is given by the user.
    name : str
        For tables and pictures.
    reference : mapping
        Reference values and their sources, as the case provides them.
    """

    material: Elastic
    contact: Contact | tuple[Contact, ...]
    law: Law
    loads: tuple[Pressure | Traction | BodyForce, ...] = ()
    supports: tuple[Support, ...] = ()
    domain: Domain | None = None
    name: str = "contact problem"
    reference: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.material, Elastic):
            raise TypeError(f"material must be PlaneStrain, PlaneStress or Solid, got {self.material!r}")
        contact = (self.contact,) if isinstance(self.contact, Contact) else tuple(self.contact)
        if not contact or not all(isinstance(c, Contact) for c in contact):
            raise TypeError(f"contact must be a Contact or a sequence of them, got {self.contact!r}")
        if not isinstance(self.law, Law) or isinstance(self.law, type):
            raise TypeError(f"law must be Frictionless(), Tresca(...), Coulomb(...) or offer at_nodes and bounds, "
                            f"got {self.law!r}")
        object.__setattr__(self, "contact", contact)
        object.__setattr__(self, "loads", tuple(self.loads))
        object.__setattr__(self, "supports", tuple(self.supports))
        for load in self.loads:
            if not isinstance(load, Pressure | Traction | BodyForce):
                raise TypeError(f"loads must be Pressure, Traction or BodyForce, got {load!r}")
            if not isinstance(load, Pressure) and len(load.components) != self.dim:
                raise ValueError(f"{load!r} has {len(load.components)} components in a {self.dim}D problem")
        for support in self.supports:
            if not isinstance(support, Support):
                raise TypeError(f"supports must be Support, got {support!r}")
            support.components(self.dim)
        names = [c.boundary for c in contact]
        if len(set(names)) < len(names):
            raise ValueError(f"a boundary is named twice as contact boundary: {names}")
        for c in contact:
            if isinstance(c.obstacle, Plane) and c.obstacle.dim != self.dim:
                raise ValueError(f"the plane in front of {c.boundary!r} is {c.obstacle.dim}D, the material {self.dim}D")
        if self.domain is not None:
            if not isinstance(self.domain, Rectangle | Box | Polygon):
                raise TypeError(f"domain must be Rectangle, Box or Polygon, got {self.domain!r}")
            if self.domain.dim != self.dim:
                raise ValueError(f"domain is {self.domain.dim}D, material {self.dim}D: use Solid in 3D, "
                                 "PlaneStrain or PlaneStress in 2D")
            self.check_boundaries(self.domain.boundaries)

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.material.dim

    @property
    def contact_boundaries(self) -> tuple[str, ...]:
        """Names of the contact boundaries."""
        return tuple(c.boundary for c in self.contact)

    def check_boundaries(self, known: tuple[str, ...]) -> None:
        """Raise ValueError unless every boundary named by the problem is one of ``known``."""
        used = {c.boundary: "contact" for c in self.contact}
        used |= {load.boundary: "a load" for load in self.loads if not isinstance(load, BodyForce)}
        used |= {s.boundary: "a support" for s in self.supports}
        for boundary, use in used.items():
            if boundary not in known:
                raise ValueError(f"boundary {boundary!r}, used for {use}, does not exist; "
                                 f"the boundaries are {', '.join(sorted(set(known)))}")
