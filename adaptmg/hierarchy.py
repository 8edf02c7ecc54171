"""Hierarchy: the same contact problem on a family of grids, coarsest first, nested or not."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import clock, compiling_seconds
from adaptmg._text import warn_user
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.scalar import ScalarProblem
from adaptmg.grids import Grids
from adaptmg.level import (
    check_coarse_to_fine,
    check_problem,
    is_small,
    joined,
    joined_on_demand,
    level_of,
    level_on_demand,
    level_under,
    meshed_domain,
    need_domain,
    the_transfer,
    touches_alike,
)
from adaptmg.mesh.arrays import MeshArrays, need_mesh
from adaptmg.problem import Assembly, Box, Contact, ContactProblem, Rectangle

if TYPE_CHECKING:
    from adaptmg.mesh.read import MeshLike
    from adaptmg.mesh.sizes import SizeField
    from adaptmg.transfer import Transfer

Divisions = int | tuple[int, ...]
#: bytes a node of the finest mesh, by dimension, from problem to solution by the default method: measured on uniform
#: and graded bars, dovetails, blocks and pairs of 700 to 66 000 nodes whose matrices are stored, smoothed elements left
#: out. Plane 1620 to 2470 B, in space 5240 to 8240 B
_BYTES = {2: 2000.0, 3: 6500.0}
#: and of one lattice, whose matrix is a table of a few rows: bars of 4200 to 263 000 nodes 655 to 1150 B, blocks of
#: 4900 to 36 000 nodes 1640 to 2960 B
_LATTICE_BYTES = {2: 900.0, 3: 2300.0}
#: processor seconds a node in the same solves: plane 3.2e-6 to 33e-6 s, in space 17e-6 to 71e-6 s
_SECONDS = {2: 10e-6, 3: 35e-6}
#: and of graded meshes, with the solve: a dovetail 43e-6 s, blocks, balls and plates 50e-6 to 420e-6 s
_MESHING = {2: 20e-6, 3: 150e-6}
#: processor seconds of the start on the coarsest level: per m^3 of m contact unknowns, whose matrix is dense, in about
#: 45 steps (balls between planes, m 876 and 2112: .7 and 9.5 s)
_DENSE = 1e-9
#: and per n^(3 - 3/dim) of n unknowns, of sparse factors (block of 14 739 and sphere on a block of 6564: 2 s each, for
#: which this gives 4.3 and .9 s)
_SPARSE = 2e-8
_MOST_LEVELS = 40  # as of a range that is meant for one number


class Forecast(NamedTuple):
    """The expected memory and time of a solve, from measured costs: :meth:`Hierarchy.forecast`.

    Attributes
    ----------
    nodes, unknowns : int
        Of the finest mesh.
    memory : float
        Bytes, from problem to solution; right to a factor of 1.5 for linear elements. A lattice is
        taken to have at least 4000 nodes, one uniform material that is not plastic, no axis of
        symmetry, and neither springs nor inclined supports; others take two to three times as much.
    seconds : float
        Of one processor like that of the measurements, meshes included, by the default method with
        a start on the coarsest level of this hierarchy; right to a factor of 4 in 14 cases, among
        them balls between planes. Where slaves are far stiffer than their masters, another method
        takes over, which takes longer in space.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8))
    >>> grids.forecast(finer=4).nodes
    1089
    """

    nodes: int
    unknowns: int
    memory: float
    seconds: float

    def __str__(self) -> str:
        return (
            f"about {self.nodes} nodes, {self.unknowns} unknowns, {1e-6 * self.memory:.2g} MB, "
            f"{self.seconds:.2g} s (meshes and a solve by the default method)"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(Grids):
    """Levels, coarsest first, and how they were made. Printing it shows a table.

    Use the constructors :meth:`uniform`, :meth:`graded`, :meth:`from_meshes`,
    :meth:`from_prolongations`, :meth:`algebraic`, :meth:`single`; :meth:`append` and :meth:`without` make more and
    fewer levels of one, :meth:`with_problem` poses another problem on its meshes.

    Attributes
    ----------
    levels : tuple of Level
        Where the finest has at most 600 unknowns (in space 500, of scalar problems 200) the coarser
        ones are made when they are first read: a solve by the default method does without.
    problem : ContactProblem, ScalarProblem or None
    origin : str
        How they were made, as text.
    timings : dict of str to float
        Wall time of making them by phase, s: "mesh", "assembly", "transfer". They add up to the
        whole.
    transfer : Transfer or None
        What built the prolongations between meshes; None for interpolation, or where there are no
        meshes.
    contact_rows : bool
        Whether the rows of contact nodes were replaced, see :meth:`from_meshes`.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> len(grids), grids.finest.discrete.n_nodes
    (2, 25)
    """

    @classmethod
    @one_blas_thread()
    def uniform(
        cls,
        problem: ContactProblem | ScalarProblem,
        divisions: Sequence[Divisions | Mapping[str, Divisions]],
    ) -> Self:
        """Return structured grids of a rectangle or box.

        ValueError for what :func:`adaptmg.mesh.structured` refuses, and more than 40 levels.

        Parameters
        ----------
        problem : ContactProblem or ScalarProblem
            With a Rectangle or Box as domain.
        divisions : sequence of int, tuple of int or mapping
            Cells along the sides, coarse to fine; nested where each divides the next. Of several
            bodies also body name -> cells. Cells more than three times as long as wide take many
            cycles (a warning).
        """
        begin = clock(), compiling_seconds()
        from adaptmg.mesh.lattices import lattices, warn_of_stretched

        domain = cast("Rectangle | Box | Assembly", need_domain(problem))
        divisions = _values_of_levels("divisions", divisions, (int, np.integer, Mapping))
        if len(divisions) > _MOST_LEVELS:
            raise ValueError(
                f"divisions must be at most {_MOST_LEVELS} levels, got {len(divisions)}"
            )
        warn_of_stretched(domain, divisions[-1])
        return cls._build(
            problem,
            [lattices(domain, n) for n in divisions],
            None,
            f"uniform {', '.join(map(_label, divisions))}",
            begin,
        )

    @classmethod
    @one_blas_thread()
    def graded(
        cls,
        problem: ContactProblem | ScalarProblem,
        sizes: Sequence[float | Mapping[str, float]] | None = None,
        contact_ratio: float | Mapping[str, float] | None = None,
        transfer: Transfer | None = None,
        contact_rows: bool = True,
        mesher: Literal["own", "netgen"] = "own",
        grading: float = 0.3,
    ) -> Self:
        """Return independent (non-nested) meshes, graded towards the contact boundaries, with
        self-similar size fields.

        The size field of each level is that of the coarsest one times the ratio of their sizes,
        everywhere: sizes at contact, away from it and between fall alike, and so does the
        discretisation error.

        Parameters
        ----------
        problem : ContactProblem or ScalarProblem
            With a domain.
        sizes : sequence of float or mapping, optional
            Element size away from contact, coarse to fine, m; of several bodies also body name ->
            size. Default: a quarter, an eighth and a sixteenth (3D: a third and a sixth) of the
            bodies' mean extent. Without ``contact_ratio`` the problem is then solved on the
            coarsest mesh, and where only a part of a boundary touches, all meshes are made finer
            there, until about 12 nodes (3D: 60) touch in each patch of the finest; where six solves
            do not reach that, or one of them fails, the meshes stay as they were. Small patches in
            space may take long: give ``sizes`` or ``contact_ratio`` to leave these solves out. Most
            nodes lie around small patches, not in them, as sizes grow slowly there: a beam of 200 mm
            between four rollers with patches of .1 mm takes 13071 nodes, 16 and 17 in each patch, and
            with ``grading=0.6`` 5664.
        contact_ratio : float or mapping, optional
            Size away from contact over size at contact (at ties where there is no contact), >= 1;
            of several bodies also body name -> ratio. Default 1; without ``sizes`` such that the
            shortest boundary of a pair has 64 elements along, in space 14 along the root of its
            area, where all of them have at most 1000 in all.
        transfer, contact_rows
            See :meth:`from_meshes`.
        mesher : {"own", "netgen"}
            What makes small elements. "own": in the plane a Delaunay triangulation of this package,
            in space bisection of a coarse mesh (of boxes our own, of other solids Netgen's, one a
            level) and improvement of shapes. "netgen": Netgen alone, which takes ten times as long
            and also meshes where "own" fails.
        grading : float
            Growth of the size per distance from contact on the coarsest level, above 0 and at most
            1; on finer ones it is smaller in the ratio of their sizes.

        Examples
        --------
        >>> problem = am.cases.greco_bar()
        >>> grids = am.Hierarchy.graded(problem, sizes=(20e-3, 10e-3), contact_ratio=4)
        >>> len(grids), grids.finest.n_nodes > grids.levels[0].n_nodes
        (2, True)
        """
        begin = clock(), compiling_seconds()
        from adaptmg.mesh import graded
        from adaptmg.mesh.grading import gradings_of, sensible_sizes

        domain = meshed_domain(problem)
        ratio = 1.0
        by_default = sizes is None and contact_ratio is None and problem.pair_boundaries
        if sizes is None:
            sizes, ratio = sensible_sizes(domain, problem.pair_boundaries)
        fine = problem.pair_boundaries or problem.tied_boundaries
        contact_ratio = ratio if contact_ratio is None else contact_ratio
        sizes = _values_of_levels("sizes", sizes, (float, int, np.number, Mapping))
        origin = (
            f"graded {', '.join(map(_label, sizes))} m, ratio {_label(contact_ratio)} at contact"
        )
        if by_default:
            origin += ", finer where few nodes touch (fewer by a larger grading= or by sizes=)"
        gradings = gradings_of(sizes, grading)

        def mesh(level: int, finer: SizeField | None = None) -> MeshArrays:
            """Return the mesh of a level; ``finer``: sizes at contact on the coarsest one."""
            size = sizes[level]
            return graded(
                domain,
                size,
                fine,
                contact_ratio,
                gradings[level],
                mesher=mesher,
                size_function=finer and (lambda x: size / sizes[0] * finer(x)),
            )

        coarsest = mesh(0)
        finer = None
        if by_default:
            from adaptmg.contact_sizes import finer_at_contact  # else the solvers are not needed

            coarsest, finer = finer_at_contact(
                cast("ContactProblem", problem),
                coarsest,
                lambda field: mesh(0, field),
                share=sizes[-1] / sizes[0],
                grading=grading,
            )
        meshes = [coarsest, *(mesh(level, finer) for level in range(1, len(sizes)))]
        return cls._build(problem, meshes, transfer, origin, begin, contact_rows)

    @classmethod
    @one_blas_thread()
    def from_meshes(
        cls,
        problem: ContactProblem | ScalarProblem,
        meshes: Sequence[MeshLike],
        transfer: Transfer | None = None,
        contact_rows: bool = True,
    ) -> Self:
        """Return a hierarchy of given meshes, coarse to fine.

        Parameters
        ----------
        problem : ContactProblem or ScalarProblem
        meshes : sequence of ngsolve.Mesh, MeshArrays or paths of mesh files (.msh, .vol)
            Checked before use; the boundary names must be those of the problem.
        transfer : Transfer, optional
            Any object with ``build(coarse, fine)``; default
            :class:`adaptmg.transfer.Interpolation`.
        contact_rows : bool
            Replace the rows of fine contact nodes by linear interpolation along the coarse contact
            boundary, whatever the transfer does elsewhere: the monotone correction is proven only
            so (or where the transfer does it).
        """
        begin = clock(), compiling_seconds()
        from adaptmg.mesh import as_mesh

        check_problem(problem)
        is_single = isinstance(meshes, (MeshArrays, str, os.PathLike)) or hasattr(meshes, "ngmesh")
        arrays = [
            as_mesh(mesh)
            for mesh in _values_of_levels("meshes", (meshes,) if is_single else meshes, ())
        ]
        return cls._build(problem, arrays, transfer, "given meshes", begin, contact_rows)

    @classmethod
    def _build(
        cls,
        problem: ContactProblem | ScalarProblem,
        meshes: list[MeshArrays],
        transfer: Transfer | None,
        origin: str,
        begin: tuple[float, float],
        contact_rows: bool = True,
    ) -> Self:
        """Return the hierarchy on meshes, coarse to fine; ``begin``: the time when their making began,
        and the seconds of compiling until then."""
        started, compiled = begin
        if isinstance(problem, ContactProblem):
            # with the slaves of pairs with sides="auto", which the finest mesh decides
            problem = Posed.of(problem, meshes[-1]).problem
            for message in (
                *_notes_on_extent(problem, meshes[-1]),
                *_overlaps(problem, meshes[-1]),
            ):
                warn_user(message)
        checks.flag("contact_rows", contact_rows)
        builder = the_transfer(transfer)
        check_coarse_to_fine(meshes)
        meshed = clock()
        finest = level_of(problem, meshes[-1])
        # of few unknowns levels are made when they are first read; errors of a given transfer come now
        on_demand = transfer is None and is_small(finest.discrete)
        posing = level_on_demand if on_demand else level_of
        joining = joined_on_demand if on_demand else joined
        levels = [*(posing(problem, mesh) for mesh in meshes[:-1]), finest]
        assembled = clock()
        for k in range(1, len(levels)):
            levels[k] = joining(levels[k - 1], levels[k], builder, contact_rows)
        timings = {
            "mesh": meshed - started,
            "assembly": assembled - meshed,
            "transfer": clock() - assembled,
        }
        if compiling_seconds() > compiled:
            timings["compiling"] = compiling_seconds() - compiled
        return cls(tuple(levels), problem, origin, timings, transfer, contact_rows)

    @one_blas_thread()
    def append(self, mesh: MeshLike) -> Self:
        """Return the hierarchy with one finer mesh (MeshArrays, ngsolve.Mesh or path); the
        levels before are neither assembled nor located again.

        It is the same as :meth:`from_meshes` makes of all meshes. The mesh need not be nested.
        ValueError if the levels are not made of meshes, or the mesh has no more nodes than the
        finest."""
        from adaptmg.mesh import as_mesh

        begin = clock()
        self._need_meshes("append")
        fine = as_mesh(mesh)
        check_coarse_to_fine([need_mesh(self.finest), fine])
        meshed = clock()
        new = level_of(self.problem, fine)
        assembled = clock()
        new = joined(self.finest, new, the_transfer(self.transfer), self.contact_rows)
        spent = {
            "mesh": meshed - begin,
            "assembly": assembled - meshed,
            "transfer": clock() - assembled,
        }
        origin = self.origin if self.origin.endswith(", grown") else f"{self.origin}, grown"
        return replace(
            self, levels=(*self.levels, new), timings=self._timings_with(spent), origin=origin
        )

    def forecast(self, finer: float = 1.0) -> Forecast:
        """Return the memory and time that a solve will take, from measured costs.

        They are proportional to the number n of nodes, for scalar problems to n / dim^2, as their blocks
        have one entry in place of dim^2. Meshes other than lattices add a time proportional to n, and
        the coarsest level, of N unknowns of which m are in contact, adds times proportional to m^3 and
        N^(3 - 3 / dim).

        Parameters
        ----------
        finer : float
            Factor by which the element sizes are smaller than those of the finest mesh.
        """
        finest = self.finest
        coordinates = finest.discrete.coordinates
        # without coordinates scalar problems count as plane ones
        dim = max(finest.discrete.dim, 2) if coordinates is None else coordinates.shape[1]
        cells = (finest.n_nodes ** (1 / dim) - 1) * checks.positive("finer", finer)
        nodes = round((cells + 1) ** dim)
        unknowns = nodes * finest.discrete.dim
        dim = max(dim, 2)  # an interval costs no more than a plane
        components = finest.discrete.dim / dim  # 1, or 1 / dim in scalar problems
        cost = nodes * components**2
        seconds = _SECONDS[dim] * cost
        if finest.mesh is not None and not finest.mesh.lattices:
            seconds += _MESHING[dim] * nodes
        coarsest = self.levels[0].discrete_or_none
        if coarsest is not None:
            seconds += _DENSE * (coarsest.dim * len(coarsest.contact)) ** 3
            seconds += _SPARSE * coarsest.n_dofs ** (3 - 3 / dim)
        lattice = finest.mesh is not None and len(finest.mesh.lattices) == 1
        memory = (_LATTICE_BYTES if lattice else _BYTES)[dim] * cost
        return Forecast(nodes, unknowns, memory, seconds)

    @one_blas_thread()
    def with_problem(self, problem: ContactProblem | ScalarProblem) -> Self:
        """Return the same meshes with another law, friction, load, material or support.

        It is, bit for bit, what :meth:`from_meshes` makes of the same meshes. Of another law, or
        other loads, matrices and prolongations are shared with this hierarchy; for other material,
        supports or obstacles, and of scalar problems, matrices are assembled again.

        ValueError if domain or contact boundaries are others, or the levels are not made of meshes.

        Parameters
        ----------
        problem : ContactProblem or ScalarProblem
            On the same domain, with contact on the same boundaries.

        Examples
        --------
        >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8))
        >>> for friction in (0.2, 0.4):
        ...     other = am.cases.greco_bar(law=am.Coulomb(friction))
        ...     result = am.solve(grids.with_problem(other), am.Multigrid())
        """
        begin = clock()
        self._need_meshes("with_problem")
        check_problem(problem)
        domain = self.problem.domain
        other = problem.domain
        if (
            domain is not None
            and other is not None
            and other is not domain
            and not _same(other, domain)
        ):
            raise ValueError(
                f"problem has another domain, {checks.shown(other)}, than these meshes, "
                f"{checks.shown(domain)}: mesh it with Hierarchy.graded or uniform"
            )
        if isinstance(problem, ScalarProblem) or isinstance(self.problem, ScalarProblem):
            return self._assembled_again(problem)
        problem = Posed.of(problem, need_mesh(self.finest)).problem
        boundaries, asked = (
            (*posed.contact_boundaries, *posed.masters, *posed.tied_boundaries)
            for posed in (self.problem, problem)
        )
        # the same sides, but slaves and masters exchanged, as sides="auto" does for another material
        if boundaries != asked and _sides_of_contacts(self.problem) == _sides_of_contacts(problem):
            return self._assembled_again(problem)
        if boundaries != asked:
            raise ValueError(
                f"problem has contact on {', '.join(filter(None, asked))}, but these meshes were made for "
                f"contact on {', '.join(filter(None, boundaries))}: use Hierarchy.graded or from_meshes"
            )
        changed = _changed_parts(problem, self.problem)
        levels = [level_under(problem, level, changed) for level in self.levels]
        assembled = clock()
        alike = [
            touches_alike(a.discrete, b.discrete) for a, b in zip(self.levels, levels, strict=True)
        ]
        for k in range(1, len(levels)):
            if not (alike[k - 1] and alike[k]):
                levels[k] = joined(
                    levels[k - 1], levels[k], the_transfer(self.transfer), self.contact_rows
                )
        spent = {"mesh": 0.0, "assembly": assembled - begin, "transfer": clock() - assembled}
        return replace(self, levels=tuple(levels), problem=problem, timings=spent)

    def _assembled_again(self, problem: ContactProblem | ScalarProblem) -> Self:
        """Return a problem on the same meshes, with nothing taken over."""
        meshes = [need_mesh(level) for level in self.levels]
        return replace(
            self.from_meshes(problem, meshes, self.transfer, self.contact_rows), origin=self.origin
        )


def _values_of_levels(name: str, value: Any, single_types: tuple[type, ...]) -> tuple[Any, ...]:
    """Return the values of the levels as a tuple; a value of one of ``single_types`` stands for one
    level."""
    if isinstance(value, single_types) and not isinstance(value, bool):
        return (value,)
    values = checks.listed(name, cast(Sequence, value), "values, one a level, coarse to fine")
    if not values:
        raise ValueError(f"{name} is empty: no meshes; give at least one, coarse to fine")
    return values


def _sides_of_contacts(problem: ContactProblem) -> list[frozenset[str]]:
    """Return the two boundaries of each contact, whichever is the slave."""
    return [
        frozenset(pair) for pair in zip(problem.contact_boundaries, problem.masters, strict=True)
    ]


def _notes_on_extent(problem: ContactProblem, mesh: MeshArrays) -> list[str]:
    """Return a message if the mesh is not one of the domain; chords of arcs may miss it a little."""
    if not hasattr(problem.domain, "lower") or mesh.dim != problem.dim:  # no domain, or a STEP file
        return []
    # lowest and highest corners of the boxes around mesh and domain
    mesh_box = mesh.box
    domain_box = np.stack([problem.domain.lower, problem.domain.upper])
    extent = np.ptp(domain_box, axis=0).max()
    beyond = np.abs(mesh_box - domain_box)
    if problem.domain.loose_box:
        # the body may be a part of the box; below a hundredth of it the lengths are likely to have another unit
        is_part = np.ptp(mesh_box, axis=0).max() > 0.01 * extent
        outwards = (mesh_box - domain_box) * [[-1.0], [1.0]]
        beyond = np.maximum(outwards, 0.0 if is_part else beyond)
    if (beyond <= 0.25 * extent).all():
        return []
    mesh_span, domain_span = (
        " to ".join(str(tuple(map(float, corner.round(9)))) for corner in box)
        for box in (mesh_box, domain_box)
    )
    return [
        f"the finest mesh spans {mesh_span} m, but problem.domain {domain_span} m: are the lengths of the mesh in mm? "
        "adaptmg takes m: scale the mesh, or give the problem its domain"
    ]


def _overlaps(problem: ContactProblem, mesh: MeshArrays) -> list[str]:
    """Return messages on bodies that overlap and are not a pair; none in axisymmetry, where a ring of
    bolts is posed so."""
    from adaptmg.mesh.soundness import overlapping_bodies

    if problem.axisymmetric or len(mesh.bodies) < 2:
        return []
    body = np.zeros(mesh.n_nodes, dtype=np.int64)
    body[mesh.elements] = cast(np.ndarray, mesh.element_body)[:, None]
    pairs = [
        coupling
        for coupling in cast(tuple, problem.contact) + cast(tuple, problem.ties)
        if not isinstance(coupling, Contact)
    ]
    paired = set()
    for pair in pairs:
        slave_bodies = set(body[mesh.boundary_nodes(pair.slave)].tolist())
        master_bodies = set(body[mesh.boundary_nodes(pair.master)].tolist())
        paired |= {frozenset(ends) for ends in product(slave_bodies, master_bodies)}
    apart = [
        ends for ends in combinations(range(len(mesh.bodies)), 2) if frozenset(ends) not in paired
    ]
    return [
        f"the bodies {mesh.bodies[a]!r} and {mesh.bodies[b]!r} lie in each other, at {x.round(9).tolist()} among "
        "other places, and are not a contact pair: nothing keeps them apart. Move one of them, or declare an "
        "am.ContactPair"
        for a, b, x in overlapping_bodies(mesh, apart)
    ]


def _label(value: object) -> str:
    """Return sizes or divisions as text."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{body}: {_label(part)}" for body, part in value.items()) + "}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _changed_parts(problem: ContactProblem, before: ContactProblem) -> frozenset[str]:
    """Return the names of the parts, except laws, that may have other values than ``before``. Functions
    may return other values."""
    changed = {
        name
        for name in ("material", "supports", "loads", "elements", "ties")
        if not _same(getattr(problem, name), getattr(before, name))
    }
    surfaces, surfaces_before = (
        tuple(replace(contact, law=None) for contact in posed.contact)
        for posed in (problem, before)
    )
    if not _same(surfaces, surfaces_before):
        changed.add("contact")
    return frozenset(changed)


_PLAIN = (type(None), bool, int, float, str, np.number, Path)


def _same(a: object, b: Any) -> bool:
    """Return whether parts have the same values; functions and objects of other modules may change
    unseen."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(_same(a[key], b[key]) for key in a)
    if is_dataclass(a) and type(a).__module__.startswith("adaptmg."):
        return all(_same(getattr(a, part.name), getattr(b, part.name)) for part in fields(a))
    return isinstance(a, _PLAIN) and bool(a == b)
