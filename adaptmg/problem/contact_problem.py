"""ContactProblem: elastic bodies, their loads and supports, and what they may touch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, get_args

import numpy as np

from adaptmg import _checks as checks
from adaptmg._checks import Flag, Name
from adaptmg._text import html_fields
from adaptmg.problem.laws import (
    EDGE_PART,
    Axisymmetric,
    Elastic,
    Frictionless,
    Law,
    PlaneStress,
    law_of_position,
)
from adaptmg.problem.loads import AnySupport, InitialStrain, Load, Preload, Pressure, Traction
from adaptmg.problem.plane_domains import Domain
from adaptmg.problem.plastic import Inelastic, elastic_material
from adaptmg.problem.surfaces import (
    AnyObstacle,
    ContactPair,
    OwnCompliance,
    OwnLaw,
    Periodic,
    Rigid,
    Tied,
    moving_parts,
)

CONTACT = "contact"  # name of all contact boundaries together
# between the Young's moduli of two bodies: the softer one would be rounding next to the stiffer one
_MOST_STIFFER = 1 / np.finfo(np.float64).eps
ELEMENTS = ("linear", "smoothed")
UNNAMED = "contact problem"  # the default name, which titles leave out
# Poisson's ratio at which Lame's first constant is EDGE_PART times the shear modulus. Smoothed elements split it
# above this value into a part on edges and one on groups of nodes, which only isotropic materials do; sheets in
# plane stress stay below
_MOST_POISSON = EDGE_PART / (2 * (1 + EDGE_PART))


def for_problem(name: str) -> str:
    """Return " for " and the name of a problem, nothing where it has none."""
    return "" if name == UNNAMED else f" for {name}"


@dataclass(frozen=True, eq=False)
class Contact(checks.Checked):
    """A boundary that may touch a rigid obstacle.

    Parameters
    ----------
    boundary : str
        Name of the contact boundary.
    obstacle : Plane, GapFunction, Moving, Rigid or user-defined
        What it may touch; a user-defined one offers ``contact`` as :meth:`Plane.contact`.
    allow_interference : bool
        Accept negative initial gaps (an interference fit).
    law : Frictionless, Tresca, Coulomb or user-defined, optional
        In place of the problem's. A node on two contact boundaries has the law of the one named
        first.
    compliance : NormalCompliance, optional
        Of its surface; default a rigid one.

    Examples
    --------
    >>> am.Contact("bottom", am.Plane(point=(0, 0), normal=(0, 1))).boundary
    'bottom'
    """

    boundary: Name
    obstacle: AnyObstacle
    allow_interference: Flag = False
    _: KW_ONLY
    law: OwnLaw | None = None
    compliance: OwnCompliance | None = None


#: the material of a body
Material = Elastic | Inelastic


def _several(*types: type) -> partial:
    """Return a check for one instance of some types, or a sequence of them."""
    return partial(checks.items, types=types)


def _materials(
    name: str, material: Material | Mapping[str, Material]
) -> Elastic | dict[str, Elastic]:
    """Return a material, or that of each body, as Elastic; ValueError if bodies do not fit
    together."""
    if not isinstance(material, Mapping) or not material:
        return elastic_material(name, material)
    material = {body: elastic_material(name, part) for body, part in material.items()}
    for body in material:
        checks.boundary_name("the names of bodies in material", body)
    kinds = {body: type(m).__name__ for body, m in material.items()}
    if len({(m.dim, isinstance(m, Axisymmetric)) for m in material.values()}) > 1:
        raise ValueError(
            f"material: the bodies must be all Solid, all Axisymmetric, or all plane, got {kinds}"
        )
    young = {body: m.young for body, m in material.items()}
    soft = min(young, key=lambda body: young[body])
    stiff = max(young, key=lambda body: young[body])
    if young[stiff] > _MOST_STIFFER * young[soft]:
        raise ValueError(
            f"material: Young's moduli must lie within a factor {_MOST_STIFFER:g} of each other, got "
            f"{young[stiff]:g} ({stiff!r}) and {young[soft]:g} ({soft!r}): use "
            "am.Contact for a rigid body"
        )
    return material


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ContactProblem(checks.Checked):
    """Bodies in contact: pure data in SI units (m, N, Pa), without a mesh.

    The theory is linear but for contact, friction and :class:`adaptmg.Plastic` bodies: small
    strains and slips, linear elasticity, linear displacements on each element; contact is sought in
    the undeformed position.
    :func:`adaptmg.solve` warns where a solution goes beyond.

    Parameters
    ----------
    material : PlaneStrain, PlaneStress, Axisymmetric, Solid or Plastic, or a mapping of str to these
        Of all bodies, or of each body by its name. A user-defined one offers ``response`` as
        :class:`~adaptmg.problem.plastic.Inelastic`.
    contact : Contact, ContactPair or sequence of them
        Without any, and without ties, a problem of linear elasticity.
    law : Frictionless, Tresca, Coulomb or user-defined
        On all contact boundaries that have no law of their own; its parameters may vary in space.
    ties : Tied, Periodic or sequence of them
        Boundaries that move together.
    loads : sequence of Pressure, Traction, BodyForce, PointForce, InitialStrain, Preload
    supports : sequence of Support, Symmetry, PointSupport, Spring, PointSpring
    domain : Domain, optional
        The geometry: Rectangle, Box, Polygon, Outline, Assembly, ...; not needed when every mesh is
        given by the user.
    elements : {"linear", "smoothed"}
        The strain of each element (the paper's), or its means around the edges of the mesh: the
        same unknowns, and a matrix with about twice the entries in the plane, three times in space;
        as many cycles in 1 to 2.7 times the seconds. Smoothed elements pay in bending (two elements
        across a cantilever have .92 of the deflection, linear ones .52), for displacements and
        forces on uniform and adapted meshes (errors 2 to 20 times smaller), and for stresses (1.5
        times). They do not pay for where contact ends, and peaks of pressure. For Poisson's ratios
        above .4, up to .5 itself, they do not lock: mean volume strains over groups of nodes are
        part of the energy (:mod:`adaptmg.discrete.volumes`), and ``Result.pressures`` of the
        solution. :class:`adaptmg.Goal` and references of :func:`adaptmg.estimate.energy_error` need
        linear ones.
    name : str
        For tables and pictures.
    reference : mapping
        Reference values and their sources, as the case provides them.

    Examples
    --------
    >>> posed = am.ContactProblem(
    ...     domain=am.Rectangle(width=1.0, height=1.0),
    ...     material=am.PlaneStrain(young=2e11, poisson=0.3),
    ...     contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))), law=am.Coulomb(0.3),
    ...     loads=(am.Pressure("top", 1e6),), supports=(am.Support("left", x=0),))
    >>> posed.dim
    2
    """

    material: Annotated[Elastic | Mapping[str, Elastic], _materials]
    contact: Annotated[tuple[Contact | ContactPair, ...], _several(Contact, ContactPair)] = ()
    law: Law | Any = None  # Any: it is None only while the problem is made
    ties: Annotated[tuple[Tied | Periodic, ...], _several(Tied, Periodic)] = ()
    loads: Annotated[tuple[Load, ...], _several(*get_args(Load))] = ()
    supports: Annotated[tuple[AnySupport, ...], _several(*get_args(AnySupport))] = ()
    domain: Domain | Any = None  # Any: only problems without a domain need the test for None
    elements: Annotated[str, partial(checks.choice, choices=ELEMENTS)] = "linear"
    name: Name = UNNAMED
    reference: Annotated[Mapping[str, Any], partial(checks.mapping, words="names to values")] = (
        field(default_factory=dict)
    )

    if TYPE_CHECKING:  # what is stored as a tuple is given as any sequence, or as one alone

        def __init__(
            self,
            *,
            material: Material | Mapping[str, Material],
            contact: Contact | ContactPair | Sequence[Contact | ContactPair] = (),
            law: Law | None = None,
            ties: Tied | Periodic | Sequence[Tied | Periodic] = (),
            loads: Load | Sequence[Load] = (),
            supports: AnySupport | Sequence[AnySupport] = (),
            domain: Domain | None = None,
            elements: str = "linear",
            name: str = UNNAMED,
            reference: Mapping[str, Any] = ...,
        ) -> None: ...

    _repr_html_ = html_fields

    def __post_init__(self) -> None:
        """Check the fields against each other, once each has been checked by its annotation."""
        super().__post_init__()
        # no law is needed where each contact has its own
        if self.law is None and all(contact.law is not None for contact in self.contact):
            object.__setattr__(self, "law", Frictionless())
        law_of_position("law", self.law)
        self._check_elements()
        for load in self.loads:
            if isinstance(load, Preload):
                if load.direction >= self.dim or (self.axisymmetric and load.axis != "y"):
                    raise ValueError(
                        f"axis of the preload of {load.body!r} must be "
                        + ("'y' in axisymmetry" if self.axisymmetric else "'x' or 'y' in the plane")
                        + f", got {load.axis!r}"
                    )
            # in the plane initial strains may have a third component, zz or hoop
            elif (
                not isinstance(load, Pressure)
                and len(load.components) != self.dim
                and not (isinstance(load, InitialStrain) and self.dim == 2)
            ):
                raise ValueError(
                    f"{checks.shown(load)} has {len(load.components)} components in a {self.dim}D problem"
                )
        for support in self.supports:
            support.components(self.dim)
            if support.boundary is None and len(support.point) != self.dim:
                raise ValueError(
                    f"{checks.shown(support)} has {len(support.point)} components in a {self.dim}D "
                    "problem"
                )
        if self.inelastic:
            self._check_inelastic()
        self._check_contact()
        self._check_sides()
        if CONTACT in self._uses and self.contact_boundaries != (CONTACT,):
            raise ValueError(
                f"the name {CONTACT!r} stands for all contact boundaries together, but names one of "
                f"several, used for {self._uses[CONTACT]}: rename it"
            )
        if self.domain is not None:
            self._check_domain(self.domain)
        if self.bodies:
            self.check_bodies(self.bodies)

    def _check_elements(self) -> None:
        """Raise ValueError if the elements do not suit a material."""
        linear = self.elements == "linear"
        for material in self._materials_of_bodies:
            if linear and material.incompressible:
                raise ValueError(
                    f"poisson must be less than 0.5 with linear elements, got {material.poisson!r}: take "
                    'elements="smoothed"'
                )
            if linear or material.anisotropy is None:
                continue
            if material.anisotropy.varies:
                raise ValueError(
                    "axes of an anisotropic material must not vary in a body with smoothed elements: take "
                    'elements="linear"'
                )
            if material.poisson > _MOST_POISSON and not isinstance(material, PlaneStress):
                raise ValueError(
                    f"an anisotropic material must have a mean Poisson's ratio of at most "
                    f"{_MOST_POISSON:g} with smoothed elements, got {material.poisson:g}: take "
                    'elements="linear"'
                )

    def _check_inelastic(self) -> None:
        """Raise ValueError for what plastic bodies do not go together with."""
        if self.by_force:
            raise ValueError(
                "contact and loads must not have Rigid obstacles or Preload next to plastic bodies: move "
                "the obstacle with am.Moving, and read the force from result.resultant"
            )
        if any(isinstance(load, InitialStrain) for load in self.loads):
            raise ValueError(
                "loads must not have InitialStrain next to plastic bodies: give all bodies elastic "
                "materials, or prescribe displacements"
            )
        if any(isinstance(material, PlaneStress) for material in self._materials_of_bodies):
            raise ValueError(
                "material must not have PlaneStress bodies next to plastic ones: take PlaneStrain"
            )

    def _check_contact(self) -> None:
        """Raise ValueError if an obstacle or a jump does not fit the dimension or the symmetry."""
        for contact in self.contact:
            if not isinstance(contact, Contact):
                continue
            dim = getattr(contact.obstacle, "dim", self.dim)
            if dim != self.dim:
                raise ValueError(
                    f"the {type(contact.obstacle).__name__} in front of {contact.boundary!r} is "
                    f"{dim}D, the material {self.dim}D"
                )
            # in axisymmetry component 1 is along the axis
            for part in moving_parts(contact.obstacle) if self.axisymmetric else ():
                if isinstance(part, Rigid):
                    along_axis = part.free == (1,)
                else:
                    along_axis = not (part.displacement[0] or part.rotation.any())
                if not along_axis:
                    raise ValueError(
                        f"the obstacle {part.name!r} in front of {contact.boundary!r} must move along the "
                        "axis only, or be pressed along it, in an axisymmetric problem"
                    )
        for tie in self.ties:
            jump = (tie.jump if isinstance(tie, Periodic) else None) or (0,) * self.dim
            if len(jump) != self.dim:
                raise ValueError(f"jump must have {self.dim} components, got {len(jump)}")

    def _check_sides(self) -> None:
        """Raise ValueError if a boundary carries nodes of two contacts or ties, or a master is a
        slave of its kind."""
        slaves = [*self.contact_boundaries, *(tie.slave for tie in self.ties)]
        if twice := [name for name in slaves if slaves.count(name) > 1]:
            raise ValueError(
                f"boundary {twice[0]!r} is named twice as contact boundary or as slave of a tie: swap "
                "slave and master of one, or cut the boundary in two"
            )
        for kind in ([pair for pair in self.contact if isinstance(pair, ContactPair)], self.ties):
            for pair in kind:
                if pair.master in [other.slave for other in kind]:
                    raise ValueError(
                        f"boundary {pair.master!r} is the master of {pair.slave!r} and slave of another "
                        "pair: swap slave and master of one, or cut the boundary in two"
                    )

    @cached_property
    def _uses(self) -> dict[str, str]:
        """Return the use of each boundary as text, by its name; of several uses the last one listed
        here."""
        used = dict.fromkeys(self.tied_boundaries, "a tie") | dict.fromkeys(
            self.pair_boundaries, "contact"
        )
        used |= {
            load.boundary: "a load" for load in self.loads if isinstance(load, Pressure | Traction)
        }
        return used | {
            support.boundary: "a support"
            for support in self.supports
            if support.boundary is not None
        }

    def _check_domain(self, domain: Domain) -> None:
        """Raise TypeError or ValueError if a domain does not fit the problem."""
        checks.instance(
            "domain", domain, Domain, "a Domain (Rectangle, Box, Polygon, Outline, Assembly, ...)"
        )
        if domain.dim != self.dim:
            raise ValueError(
                f"domain is {domain.dim}D, material {self.dim}D: use Solid in 3D, "
                "PlaneStrain, PlaneStress or Axisymmetric in 2D"
            )
        if self.axisymmetric and not domain.lower[0] >= 0:
            raise ValueError(
                f"domain reaches to x = {domain.lower[0]:g} m, but x is the radius of an axisymmetric "
                "problem: it must be >= 0"
            )
        if domain.boundaries is not None:
            self.check_boundaries(domain.boundaries)

    @property
    def dim(self) -> int:
        """Return the space dimension."""
        return self._materials_of_bodies[0].dim

    @property
    def axisymmetric(self) -> bool:
        """Return whether the bodies are :class:`Axisymmetric`."""
        return isinstance(self._materials_of_bodies[0], Axisymmetric)

    @property
    def by_force(self) -> bool:
        """Return whether forces are prescribed whose motions are unknown: those of rigid obstacles,
        of preloads."""
        return any(isinstance(load, Preload) for load in self.loads) or any(
            isinstance(contact, Contact) and isinstance(contact.obstacle, Rigid)
            for contact in self.contact
        )

    @property
    def inelastic(self) -> bool:
        """Return whether a body is plastic, or of another material with a history."""
        return any(material.inelastic is not None for material in self._materials_of_bodies)

    @property
    def _materials_of_bodies(self) -> list[Elastic]:
        """Return the materials: the one of all bodies, or that of each."""
        return (
            [self.material] if isinstance(self.material, Elastic) else list(self.material.values())
        )

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return the names of the bodies, of the domain or else of the materials; () where only the
        mesh knows them."""
        if self.domain is not None and self.domain.bodies is not None:
            return self.domain.bodies
        return () if isinstance(self.material, Elastic) else tuple(self.material)

    @cached_property
    def contact_boundaries(self) -> tuple[str, ...]:
        """Return the boundaries that carry contact nodes, in the order of ``contact``; of a pair
        the slave."""
        return tuple(c.boundary for c in self.contact)

    @cached_property
    def masters(self) -> tuple[str, ...]:
        """Return for each of ``contact`` the master boundary, "" for a rigid obstacle."""
        return tuple(c.master if isinstance(c, ContactPair) else "" for c in self.contact)

    @cached_property
    def pair_boundaries(self) -> tuple[str, ...]:
        """Return the distinct names of all boundaries that may touch, masters too: where meshes are
        to be fine."""
        pairs = zip(self.contact_boundaries, self.masters, strict=True)
        return tuple(dict.fromkeys(name for pair in pairs for name in pair if name))

    @cached_property
    def tied_boundaries(self) -> tuple[str, ...]:
        """Return the distinct names of all tied boundaries."""
        return tuple(dict.fromkeys(name for tie in self.ties for name in (tie.slave, tie.master)))

    def check_boundaries(self, known: tuple[str, ...]) -> None:
        """Raise ValueError unless every boundary named by the problem is one of ``known``."""
        for boundary, use in self._uses.items():
            if boundary not in known:
                raise ValueError(
                    f"boundary {boundary!r}, used for {use}, does not exist"
                    f"{checks.suggestion(boundary, known)}; the boundaries are "
                    f"{', '.join(sorted(set(known)))}"
                )

    def check_bodies(self, known: tuple[str, ...]) -> None:
        """Raise ValueError unless the materials name exactly the bodies ``known``, and loads and
        supports, where they name a body, one of them."""
        if not isinstance(self.material, Elastic) and set(self.material) != set(known):
            raise ValueError(
                f"material must name each body once: the bodies are {', '.join(map(repr, known))}, "
                f"material names {', '.join(map(repr, self.material))}"
            )
        for item in (*self.loads, *self.supports):
            body = getattr(item, "body", None)
            if body is not None and body not in known:
                use = "a load" if item in self.loads else "a support"
                raise ValueError(
                    f"body {body!r}, used for {use}, does not exist"
                    f"{checks.suggestion(body, known)}; the bodies are {', '.join(map(repr, known))}"
                )
