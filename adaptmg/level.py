"""Level: one grid of a hierarchy, with the problem on it and the prolongation from the next coarser
one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import shortened
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.scalar import ScalarProblem
from adaptmg.mesh.arrays import MeshArrays, need_mesh
from adaptmg.problem import Assembly, ContactProblem, Cracked, PointForce, PointSpring, PointSupport
from adaptmg.problem.plane_domains import Domain, with_vertex

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer


@dataclass(frozen=True, eq=False, init=False)
class Level:
    """One grid.

    Parameters
    ----------
    discrete : DiscreteProblem or None
        The problem discretised on this grid; None where only a coarse space is known.
    mesh : MeshArrays, optional
        None if the level comes from matrices; see :func:`adaptmg.mesh.need_mesh`.
    prolongation : csr_array, optional
        Nodal values from the next coarser level (n_nodes, n_nodes coarse), or, between coarse
        spaces, its dofs (n_dofs, n_dofs coarse); the coarsest level has none.
    galerkin : bsr_array, optional
        The matrix of a coarse space without a discrete problem.
    surface_prolongation : csr_array, optional
        With bodies in contact: the prolongation whose contact rows are >= 0 with sums 1, for
        corrections that need it (:mod:`adaptmg.transfer.contact`).
    posed : Posed, optional
        What ``discrete`` was made of: a contact problem on the mesh.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> grids.finest.prolongation.shape  # to its nodes from those of the level below
    (25, 9)
    """

    discrete_or_none: DiscreteProblem | None
    mesh: MeshArrays | None
    prolongation_or_none: sparse.csr_array | None
    galerkin: sparse.bsr_array | None
    surface_prolongation: sparse.csr_array | None
    posed: Posed | None

    def __init__(
        self,
        discrete: DiscreteProblem | None,
        mesh: MeshArrays | None = None,
        prolongation: sparse.csr_array | None = None,
        galerkin: sparse.bsr_array | None = None,
        surface_prolongation: sparse.csr_array | None = None,
        posed: Posed | None = None,
    ) -> None:
        if discrete is not None:
            checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem or None")
        elif not isinstance(galerkin, sparse.bsr_array):
            raise TypeError(
                "galerkin must be a bsr_array without a discrete problem, got "
                f"{checks.described(galerkin)}"
            )
        if galerkin is not None:
            rows, columns = checks.shape_of(checks.sparse_matrix("galerkin", galerkin))
            if rows != columns:
                raise ValueError(f"galerkin must be square, got {(rows, columns)}")
            galerkin = checks.indices_frozen(galerkin)
        checks.instance(
            "mesh",
            mesh,
            (MeshArrays, type(None)),
            "MeshArrays or None; adaptmg.mesh.as_mesh converts",
        )
        self.__dict__.update(
            discrete_or_none=discrete,
            mesh=mesh,
            prolongation_or_none=_checked_csr("prolongation", prolongation),
            galerkin=galerkin,
            surface_prolongation=_checked_csr("surface_prolongation", surface_prolongation),
            posed=posed,
        )

    def __repr__(self) -> str:
        return shortened(f"Level of {self.n_nodes} nodes: {self.discrete_or_none}, {self.mesh}")

    def posing(self, **parts: object) -> Level:
        """Return the level with other parts, by the names of the arguments of Level; they are not
        checked."""
        result = object.__new__(Level)
        result.__dict__.update(vars(self))
        result.__dict__.update({_FIELDS.get(name, name): part for name, part in parts.items()})
        return result

    @classmethod
    def on_demand(cls, make: Callable[[], Level], **parts: object) -> Level:
        """Return a level that has some ``parts``, by the names of the arguments of Level, and takes the
        others from what ``make`` returns, when the first of them is read. Levels that pose other
        problems on it share these."""
        return object.__new__(cls).posing(_make=cache(make), **parts)

    @property
    def complete(self) -> bool:
        """Return whether all parts are made."""
        return "_make" not in vars(self)

    if not TYPE_CHECKING:  # type checkers see the fields alone

        def __getattr__(self, name: str) -> object:
            """Return a part that is not made yet, and make all."""
            make = self.__dict__.get("_make")  # None: another thread has made them meanwhile
            if make is not None and name in self.__dataclass_fields__:
                self.__dict__.update({**vars(make()), **vars(self)})
                self.__dict__.pop("_make", None)
            if name not in self.__dict__:
                raise AttributeError(f"a Level has no attribute {name!r}")
            return self.__dict__[name]

    def __getstate__(self) -> dict[str, object]:
        """Return all parts, for pickle."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @property
    def discretised(self) -> bool:
        """Return whether the problem is discretised on this grid; else it is only a coarse space."""
        return self.discrete_or_none is not None

    @property
    def discrete(self) -> DiscreteProblem:
        """Return the problem discretised on this grid; ValueError for a coarse space without
        one."""
        if self.discrete_or_none is None:
            raise ValueError("this level is only a coarse space, without a discrete problem")
        return self.discrete_or_none

    @property
    def prolongation(self) -> sparse.csr_array:
        """Return the prolongation from the next coarser level; ValueError on the coarsest."""
        if self.prolongation_or_none is None:
            raise ValueError("the coarsest level has no prolongation")
        return self.prolongation_or_none

    @property
    def contact_prolongation(self) -> sparse.csr_array:
        """Return the form of the prolongation for corrections that carry constraints to the coarse
        contact nodes."""
        return self.prolongation if self.surface_prolongation is None else self.surface_prolongation

    @property
    def matrix(self) -> sparse.bsr_array:
        """Return the discretised matrix, or the Galerkin one of a coarse space."""
        coarse = None if self.discretised else self.galerkin
        return self.discrete.matrix if coarse is None else coarse

    @cached_property
    def n_nodes(self) -> int:
        """Return the number of nodes; of a coarse space of the rows of blocks of its matrix."""
        if self.discretised:
            return self.discrete.n_nodes
        return checks.shape_of(self.matrix)[0] // self.matrix.blocksize[0]

    @property  # not kept: :meth:`posing` hands over what is
    def nonzeros(self) -> int:
        """Return the number of stored entries of the matrix."""
        return self.discrete.rows.nonzeros if self.discretised else self.matrix.nnz

    def prolong(self, u: ArrayLike) -> np.ndarray:
        """Return values on this level from those on the next coarser one (primal): P u.

        Parameters
        ----------
        u : (n_nodes coarse,) or (n_nodes coarse, k) array
            Nodal values, of displacements say, between bodies relative to the master
            (``discrete.relative``). Between coarse spaces (n_dofs coarse,).

        Returns
        -------
        array
            (n_nodes,) or (n_nodes, k).

        Examples
        --------
        >>> level = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)).finest
        >>> level.inject(level.prolong(range(9))).astype(int).tolist()
        [0, 1, 2, 3, 4, 5, 6, 7, 8]
        """
        return self.prolongation @ _nodal("u", u, checks.shape_of(self.prolongation)[1])

    def restrict(self, r: ArrayLike) -> np.ndarray:
        """Return forces or residuals (dual) on the next coarser level from those on this one: P' r,
        with the same work on all coarse displacements.

        Parameters
        ----------
        r : (n_nodes,) or (n_nodes, k) array
        """
        return self.prolongation.T @ _nodal("r", r, checks.shape_of(self.prolongation)[0])

    def inject(self, u: ArrayLike) -> np.ndarray:
        """Return values (primal) on the next coarser level from those on this one: of the node with
        the largest weight in each column of P, on nested meshes the node at the same place.

        Parameters
        ----------
        u : (n_nodes,) or (n_nodes, k) array
        """
        nodes = np.asarray(sparse.csc_array(self.prolongation).argmax(axis=0)).reshape(-1)
        return _nodal("u", u, checks.shape_of(self.prolongation)[0])[nodes]


def _nodal(name: str, value: ArrayLike, rows: int) -> np.ndarray:
    """Return an array of this number of rows, checked."""
    return checks.array(name, value, (rows, *[None] * (np.ndim(value) - 1)))


#: fields of a level by the names of the arguments that they come from, if these differ
_FIELDS = {"discrete": "discrete_or_none", "prolongation": "prolongation_or_none"}


def _checked_csr(name: str, matrix: object) -> sparse.csr_array | None:
    """Return a sparse matrix, checked, as csr of float64 with read-only indices; None stays."""
    if matrix is None:
        return None
    checked = checks.sparse_matrix(name, matrix)
    if not isinstance(checked, sparse.csr_array) or checked.dtype != np.float64:
        checked = sparse.csr_array(checked).astype(np.float64, copy=False)
    return checks.indices_frozen(checked)


def the_transfer(transfer: Transfer | None) -> Transfer:
    """Return a transfer, checked; interpolation for None."""
    from adaptmg.transfer import Interpolation

    transfer = Interpolation() if transfer is None else transfer
    return checks.offers(
        "transfer",
        transfer,
        "build",
        "a transfer, which offers build(coarse, fine) -> sparse matrix",
    )


def level_of(problem: ContactProblem | ScalarProblem, mesh: MeshArrays) -> Level:
    """Return the problem on a mesh."""
    if isinstance(problem, ScalarProblem):
        return Level(problem.on(mesh), mesh)
    return discretised_level(Posed.of(problem, mesh))


def discretised_level(posed: Posed) -> Level:
    """Return a contact problem that is posed on a mesh, discretised there."""
    from adaptmg.discrete.discretise import assembled

    return Level(assembled(posed), posed.mesh, posed=posed)


#: unknowns up to which one solve takes the finest of several levels alone, by dimension. CPU seconds of hierarchy and
#: solve over those by full multigrid: GRECO bar at 162 to 578 unknowns .56 to .78 (.89 and .99 at 882 and 1250), GRECO
#: block at 375 .79 (.81 and 1.09 at 648 and 1029), twisted square bar at 81 and 169 .58 and .84 (.44 at 289)
SMALL = {1: 200, 2: 600, 3: 500}


def is_small(problem: DiscreteProblem) -> bool:
    """Return whether the active set method is quicker than multigrid with the set-up of its levels; with
    pressures as unknowns it takes several solves."""
    return problem.n_dofs <= SMALL[problem.dim] and not len(problem.volumes)


def level_on_demand(problem: ContactProblem | ScalarProblem, mesh: MeshArrays) -> Level:
    """Return the problem on a mesh, a contact problem discretised when it is first read."""
    if isinstance(problem, ScalarProblem):
        return level_of(problem, mesh)
    posed = Posed.of(problem, mesh)  # refuses what does not fit
    return Level.on_demand(partial(discretised_level, posed), mesh=mesh, posed=posed)


def level_under(problem: ContactProblem, level: Level, changed: frozenset[str]) -> Level:
    """Return a level under a problem that differs in the parts ``changed`` and in the law."""
    from adaptmg.discrete.discretise import reassembled

    before = None if changed - {"loads"} else level.posed
    posed = Posed.of(problem, need_mesh(level)) if before is None else before.under(problem)
    return level.posing(discrete=reassembled(posed, level.discrete, changed), posed=posed)


def touches_alike(a: DiscreteProblem, b: DiscreteProblem) -> bool:
    """Return whether the same nodes carry contact and follow the same others, so that prolongations
    are the same."""

    def parts(problem: DiscreteProblem) -> list:
        """Return the data that prolongations depend on."""
        contact = problem.contact
        coupling = problem.coupling
        result: list = [contact.names, contact.masters, contact.nodes, contact.boundary]
        if coupling is not None:
            weights = coupling.weights
            # fixed: held nodes of masters do not let what faces them move beyond its obstacle
            result += [weights.indptr, weights.indices, weights.data, problem.fixed]
        return result

    return len(parts(a)) == len(parts(b)) and all(map(np.array_equal, parts(a), parts(b)))


def joined(below: Level, above: Level, transfer: Transfer, contact_rows: bool) -> Level:
    """Return the level ``above`` with its prolongation from the next coarser level ``below``."""
    from adaptmg.transfer.contact import between_levels

    # of scalar problems all nodes may be contact nodes: there are no rows along boundaries
    if above.discrete.dim == 1:
        nodal = transfer.build(need_mesh(below), need_mesh(above))
        return Level(above.discrete, above.mesh, nodal)
    rows = between_levels(
        transfer,
        need_mesh(below),
        need_mesh(above),
        below.discrete,
        above.discrete,
        contact_rows,
    )
    return above.posing(
        prolongation=checks.indices_frozen(rows.prolongation),
        surface_prolongation=None if rows.surface is None else checks.indices_frozen(rows.surface),
    )


def joined_on_demand(below: Level, above: Level, transfer: Transfer, contact_rows: bool) -> Level:
    """Return the level ``above``, whose prolongation is built when it is first read."""
    # the parts that are made: to read others would make them
    posed = {
        name: part
        for name, part in vars(above).items()
        if name in ("discrete_or_none", "mesh", "posed")
    }
    return Level.on_demand(partial(joined, below, above, transfer, contact_rows), **posed)


def check_problem(problem: object) -> None:
    """Raise TypeError unless it is a problem to be posed on meshes."""
    checks.instance(
        "problem", problem, (ContactProblem, ScalarProblem), "a ContactProblem or ScalarProblem"
    )


def need_domain(problem: ContactProblem | ScalarProblem) -> Domain:
    """Return the domain of a problem; ValueError if it has none to mesh."""
    check_problem(problem)
    if problem.domain is None:
        raise ValueError(
            "problem.domain is None: give the problem a domain, or meshes with Hierarchy.from_meshes "
            "(in an adaptive loop engine=am.Bisect())"
        )
    return problem.domain


def meshed_domain(problem: ContactProblem | ScalarProblem) -> Domain:
    """Return the domain of a problem, with a vertex where a point support, spring or force
    lies on a straight plane edge."""

    def cut(domain: Domain, body: str | None) -> Domain:
        """Return the domain of a body with these vertices."""
        if domain.dim != 2:
            return domain
        # a single body has no name here; a part without a body may be at any of them
        points = [
            part.point
            for part in (*problem.supports, *problem.loads)
            if isinstance(part, PointSupport | PointSpring | PointForce)
            and (body is None or part.body in (None, body))
        ]
        for point in points:
            domain = (
                replace(domain, domain=with_vertex(domain.domain, point))
                if isinstance(domain, Cracked)
                else with_vertex(domain, point)
            )
        return domain

    whole = need_domain(problem)
    if isinstance(whole, Assembly):
        return replace(whole, parts={name: cut(part, name) for name, part in whole.parts.items()})
    return cut(whole, None)


def check_coarse_to_fine(meshes: Sequence[MeshArrays]) -> None:
    """Raise ValueError unless each mesh has more nodes than the one before."""
    sizes = [mesh.n_nodes for mesh in meshes]
    if any(a >= b for a, b in pairwise(sizes)):
        raise ValueError(f"meshes must go from coarse to fine; they have {sizes} nodes")
