r"""Rigid-body statics: can contact hold the motions that the supports leave free, and is friction
too large?

Rigid motions m of a body that vanish at its fixed dofs cost no energy. A solution exists only if
admissible contact forces balance the load on each of them,

.. math:: \sum_i (-p_i n_i + t_i)\cdot m(x_i) + b\cdot m = 0,\qquad p_i \ge 0,\quad |t_i| \le s_i + \mu_i p_i,

a linear programme in the forces with one row per free motion. In 2D the friction cone is exact; in
3D it is replaced by a circumscribed regular polygon of 16 sides (the condition is necessary, not
sufficient): the Tresca part is a sum of eight segments, the Coulomb part a cone over the corners,
so that every inequality bounds one variable. The multipliers of the least unbalanced force are a
motion that nothing holds.

Where one node touches alone, with C the compliance of the body at that node and :math:`K = C^{-1}`,
pressing and slipping balance in one way only if :math:`\mu\,|K_{nt}| < K_{tt}`. Beyond, open, slip
and stick may all be equilibria of the same load (A. Klarbring, Ingenieur-Archiv 60, 1990,
doi:10.1007/BF00541909). This is an estimate: with several nodes in contact the bound is another
one."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import frames_of
from adaptmg.discrete.elasticity import dofs_of, rotations
from adaptmg.discrete.loads import largest_nodal_stiffness
from adaptmg.discrete.problem import DiscreteProblem, remembered, remembered_of_structure
from adaptmg.grids import Grids
from adaptmg.multigrid.rigid_motions import orthonormal_null_combinations
from adaptmg.problem.laws import sampled_friction
from adaptmg.problem.loads import PointSpring, Spring
from adaptmg.smoother.factorisation import eliminated, node_graph
from adaptmg.smoother.system import STICK, contact_blocks
from adaptmg.solver.advice import advise, critical_coefficients, warn_where_steep
from adaptmg.solver.examine import ContactResult

_LOG = logging.getLogger(__name__)

# nodal stiffness of a spring, over the largest of the bodies, from which on it counts: as measured, a block on
# rollers with 16, 32, 64 divisions converges, to 5e-6, with 2.5e-11, 3.5e-11, 4.4e-11; with 32, 64
# it stalls at 1.8e-11, 2.5e-11
_SOFTEST = 4e-11
# largest coefficient of friction that messages name as sufficient: the tangent of 89 degrees
_STEEPEST = 57.0
_SEGMENTS = 8  # of the friction polygon in 3D, which has twice as many sides


@remembered
def check_statics(problem: DiscreteProblem) -> None:
    """Raise ValueError if a rigid motion is left free by the supports and contact cannot hold
    it."""
    for nodes, motions, several in _free_parts(problem) or ():
        _check_body(_Body(problem, nodes, motions, several))


@remembered_of_structure
def _free_parts(problem: DiscreteProblem) -> list[tuple[np.ndarray, np.ndarray, bool]] | None:
    """Return (nodes (n,), free motions (n * dim, k), whether there are several parts) of each connected
    part with free motions; None if the rigid motions are unknown."""
    if problem.near_nullspace is None:
        return None
    # strongly connected parts: of a symmetric matrix the same without a transpose of the graph, but
    # not in the order of their first nodes
    n_bodies, body_of = connected_components(node_graph(problem.matrix), connection="strong")
    stiff = problem.matrix @ problem.near_nullspace
    free = np.stack([problem.free_part(mode) for mode in problem.near_nullspace.T], axis=1)
    held = problem.near_nullspace - free
    bodies = np.split(np.argsort(body_of, kind="stable"), np.cumsum(np.bincount(body_of))[:-1])
    # a single node is not an elastic body: only its diagonal block can hold it
    parts = [
        (nodes, _free_motions(problem, stiff, held, nodes), n_bodies > 1)
        for nodes in sorted(bodies, key=lambda nodes: nodes[0])
        if len(nodes) > 1
    ]
    return [part for part in parts if part[1].shape[1]]


def check_statics_of(grids: Grids) -> None:
    """Call :func:`check_statics` on the coarsest level, and on the finest one only if that fails, if
    there are springs, or if the coarsest does not know its rigid motions. A coarse grid has the same
    rigid motions, loads and directions of contact and costs little; on a curved surface the finest
    may hold a motion that the coarsest does not."""
    coarsest = grids[0].discrete_or_none
    # a spring may count at nodes of a coarse grid, and be too soft at those of a finer one
    sprung = grids.problem is not None and any(
        isinstance(support, Spring | PointSpring) for support in grids.problem.supports
    )
    if len(grids) > 1 and not sprung and coarsest is not None and _free_parts(coarsest) is not None:
        try:
            check_statics(coarsest)
            return
        except ValueError as error:
            _LOG.info("the coarsest grid cannot be held (%s); asking the finest", error)
    try:
        check_statics(grids.finest.discrete)
    except ValueError as error:
        raise ValueError(f"{error}{_too_soft(grids)}") from None


def _too_soft(grids: Grids) -> str:
    """Return as text which springs are too soft to count on the finest grid, and from which stiffness on
    they surely count; "" if there are none."""
    level = grids.finest
    problem = grids.problem
    if problem is None or level.mesh is None:
        return ""
    least = _SOFTEST * np.abs(level.discrete.matrix.data).max()
    text = ""
    for support in problem.supports:
        if not isinstance(support, Spring | PointSpring):
            continue
        nodal_stiffness = largest_nodal_stiffness(level.mesh, support, problem.axisymmetric)
        if nodal_stiffness <= least:
            names = (
                ("normal", "tangential") if isinstance(support, Spring) else "xyz"[: problem.dim]
            )
            unit = replace(support, **dict.fromkeys(names, 1.0))
            # one per cent more, since the number is printed rounded
            limit = 1.01 * least / largest_nodal_stiffness(level.mesh, unit, problem.axisymmetric)
            text += (
                f". The spring on {support.place!r} counts as none: double precision needs at least "
                f"{limit:.3g} {'N/m^3' if isinstance(support, Spring) else 'N/m'} next to these bodies"
            )
    return text


@dataclass(frozen=True, eq=False)
class _Body:
    """A part of a problem that its elements connect."""

    problem: DiscreteProblem
    nodes: np.ndarray  # (n,) int, ascending
    motions: np.ndarray  # (n * dim, k): free rigid motions, with amplitudes about 1
    several: bool  # whether the problem has other parts

    @property
    def remedy(self) -> str:
        """Return what to add where a motion is free, as text."""
        if self.problem.dim == 1:
            return "prescribe values (held of a ScalarProblem, fixed of a DiscreteProblem)"
        return "add a support that fixes it"

    @property
    def pieces(self) -> list[tuple[str, np.ndarray]]:
        """Return the names of the bodies of this part in messages, and their nodes (n,): of a single body
        the name is empty."""
        bodies = self.problem.bodies or {}
        # a body lies in one part: its first node tells whether in this one
        inside = [
            (f"body {name!r}", nodes)
            for name, nodes in bodies.items()
            if np.isin(nodes[:1], self.nodes).any()  # bodies without nodes lie in none
        ]
        if inside and (self.several or len(inside) > 1):
            return inside
        return [
            (
                f"the body of node {self.nodes[0]} ({len(self.nodes)} nodes)"
                if self.several
                else "",
                self.nodes,
            )
        ]

    def describe(self, coefficients: np.ndarray) -> str:
        """Return a free motion, given by its coefficients (k,), as text."""
        problem = self.problem
        relative = np.zeros((problem.n_nodes, problem.dim))
        relative[self.nodes] = (self.motions @ coefficients).reshape(len(self.nodes), -1)
        field = problem.physical(relative)
        # a piece that moves by less than a millionth of the largest motion is at rest
        moving = [
            (whose, nodes)
            for whose, nodes in self.pieces
            if np.abs(field[nodes]).max() > 1e-6 * np.abs(field).max()
        ]
        return " and ".join(
            self._described(nodes, field[nodes]) + (f" of {whose}" if whose else "")
            for whose, nodes in moving
        )

    def _described(self, nodes: np.ndarray, field: np.ndarray) -> str:
        """Return a motion (n, dim) of some nodes as text."""
        if self.problem.dim == 1:
            return "constant"
        # translation of the centre, then turns about it, over the size
        motions, centre, size = _axis_motions(self.problem, nodes)
        twist = np.linalg.lstsq(motions, field.reshape(-1), rcond=None)[0]
        negligible = 1e-6 * np.abs(field).max()
        dim = self.problem.dim
        if np.abs(motions @ twist - field.reshape(-1)).max() > negligible:
            return "motion (a combination of near_nullspace)"
        translation = twist[:dim]
        rotation = twist[dim:] / size
        if size * np.abs(rotation).max(initial=0.0) <= negligible:
            return f"translation along {_axis(translation)}"
        # the points that do not move: t + omega x (x - centre) = 0, along a screw's axis up to its
        # translation
        if dim == 2:
            return f"rotation about {_vector(centre + np.array([-translation[1], translation[0]]) / rotation, size)}"
        pole = centre + np.cross(rotation, translation) / (rotation @ rotation)
        kind = (
            "screw motion"
            if abs(translation @ rotation) > negligible * np.linalg.norm(rotation)
            else "rotation"
        )
        return f"{kind} about the axis along {_axis(rotation)} through {_vector(pole, size)}"


def _free_motions(
    problem: DiscreteProblem, stiff: np.ndarray, held: np.ndarray, nodes: np.ndarray
) -> np.ndarray:
    """Return rigid motions (n * dim, k) of a part with the nodes (n,) that supports leave free and that
    cause no force; ``stiff`` (n_dofs, m) is the matrix times all rigid motions, ``held`` (n_dofs, m)
    what supports hold of them."""
    dofs = dofs_of(nodes, problem.dim)
    modes = problem.near_nullspace[dofs]
    forces = stiff[dofs] / np.abs(problem.matrix.data).max()
    # the modes of all bodies, restricted to one, are dependent: their Gram matrix gives an orthogonal
    # basis, of length sqrt(n_nodes), so that nodes move by about 1
    gram_values, gram_vectors = np.linalg.eigh(modes.T @ modes)
    # squares of lengths: their roots differ by six digits
    independent = gram_values > checks.SIX_DIGITS**2 * gram_values[-1]
    if not independent.any():  # no mode moves this part
        return modes[:, :0]
    basis = gram_vectors[:, independent] * np.sqrt(len(nodes) / gram_values[independent])
    modes = modes @ basis
    forces = forces @ basis
    strained = np.linalg.norm(forces, axis=1) > _SOFTEST
    # springs far softer than the body hold it too: forces count over the largest one
    scale = np.abs(forces).max(initial=0.0) if strained.any() else 1.0
    # the entries of both kinds of rows are about 1 at most
    of_supports = held[dofs] @ basis
    rows = np.vstack([of_supports[of_supports.any(axis=1)], forces[strained] / scale])
    return modes @ orthonormal_null_combinations(rows, checks.SIX_DIGITS).T


def _check_body(body: _Body) -> None:
    """Raise ValueError where contact cannot balance the load on a free motion, where the solution
    is not unique, or where nothing presses a body that contact does not enclose."""
    problem = body.problem
    load = problem.load[dofs_of(body.nodes, problem.dim)]
    scale = float(np.abs(load).sum()) or 1.0
    work = load @ body.motions / scale
    limit, _ = problem.law.bounds(len(problem.contact))
    friction = sampled_friction(problem.law, len(problem.contact)).max(axis=0)
    forces = _contact_forces(body, limit / scale, friction)
    _check_balance(body, forces, work)
    _check_unique(body, forces, has_friction=bool(friction.any()))
    if np.abs(work).max() <= checks.SIX_DIGITS:
        _check_enclosed(body, forces)


def _check_balance(body: _Body, forces: _Forces, work: np.ndarray) -> None:
    """Raise ValueError unless contact forces balance the ``work`` (k,) of the load on free motions."""
    unbalanced, motion = forces.least_unbalanced(work)
    if unbalanced > checks.SIX_DIGITS:
        motion = _motion_to_blame(body, forces, work, motion)
        raise ValueError(
            f"nothing holds a {body.describe(motion)}: the supports leave it free, and contact cannot "
            f"balance the load on it{_required_friction(body, work)}; {body.remedy}"
        )


def _check_unique(body: _Body, forces: _Forces, has_friction: bool) -> None:
    """Raise ValueError if no contact force works on some free motion; after :func:`_check_balance` the
    load does not, either."""
    neutral = orthonormal_null_combinations(
        np.hstack([forces.edges, forces.segments]).T, checks.SIX_DIGITS
    )
    if not len(neutral):
        return
    motion = body.describe(_axis_motion_in_span(body, neutral))
    remedy = body.remedy
    if motion.startswith("rotation") and forces.edges.size and not has_friction:
        # no pressure works on a body that is round where it touches
        remedy += ", or model half of a round body, or give its contact a little friction"
    raise ValueError(
        f"the solution is not unique: a {motion} is left free by supports, contact and load; {remedy}"
    )


def _check_enclosed(body: _Body, forces: _Forces) -> None:
    """Raise ValueError unless contact encloses a body without a load on its free motions, so that
    pressures at all nodes may balance each other. If factors c >= 0 of the n edges balance their mean,
    edges with the factors c + 1/n > 0 balance each other. Tresca's friction presses nothing."""
    mean_edge = forces.edges.mean(axis=1)
    pressures = replace(forces, limits=np.zeros_like(forces.limits))
    unbalanced, motion = pressures.least_unbalanced(mean_edge)
    if unbalanced > checks.SIX_DIGITS:
        motion = _axis_motion_or(body, pressures, mean_edge, motion)
        raise ValueError(
            f"nothing presses the body against its obstacle: a {body.describe(motion)} is left free "
            f"by supports and load; {body.remedy}, or a load"
        )


def _required_friction(body: _Body, work: np.ndarray) -> str:
    """Return the least coefficient of friction that balances the ``work`` (k,) on the free motions, as
    text; "" if none up to ``_STEEPEST`` does."""
    n = len(body.problem.contact)

    def excess(coefficient: float) -> float:
        """Return by how much the unbalanced work exceeds what counts as balanced, SIX_DIGITS."""
        forces = _contact_forces(body, limit=np.zeros(n), friction=np.full(n, coefficient))
        return forces.least_unbalanced(work)[0] - checks.SIX_DIGITS

    if body.problem.dim == 1 or excess(_STEEPEST) > 0:
        return ""
    from scipy.optimize import bisect

    least = bisect(excess, 0.0, _STEEPEST, rtol=1e-4)
    # rounded, and in 3D up to 1.9 % too small: a polygon of 16 sides around the circle limits friction
    return (
        f" without friction of about {least:.3g} or more, the tangent of "
        f"{np.degrees(np.arctan(least)):.3g} degrees"
    )


def advise_on_free_motions(problem: DiscreteProblem, contact: ContactResult) -> None:
    """Warn of rigid motions that slide at all nodes which touch in an iterate that did not
    converge, and turn about those that stick."""
    for nodes, motions, several in _free_parts(problem) or ():
        body = _Body(problem, nodes, motions, several)
        k = motions.shape[1]
        place_in_body = np.searchsorted(nodes, contact.node)
        touches = contact.closed & np.isin(contact.node, nodes)
        moved = motions.reshape(len(nodes), problem.dim, k)[place_in_body[touches]]
        local_motions = np.einsum("nij,njk->nik", contact.frames[touches], moved)
        sticks = contact.state[touches] == STICK
        # none moves along a normal, none that sticks along a tangent; without nodes all are free, of
        # which a row of zeros keeps the number
        held = [np.zeros((1, k)), local_motions[:, 0], local_motions[sticks, 1:].reshape(-1, k)]
        free = orthonormal_null_combinations(np.concatenate(held), checks.SIX_DIGITS)
        if len(free):
            advise(
                "free",
                f"no converged solution was found, and in the last iterate nothing but friction resists a "
                f"{body.describe(_axis_motion_in_span(body, free))}: add a support that fixes it, or "
                "load the body less sideways",
                RuntimeWarning,
            )


@dataclass(frozen=True, eq=False)
class _Forces:
    """Admissible contact forces, by their work on the k free motions; forces in units of the
    load."""

    # (k, n_edges): edges of the Coulomb cones (without friction unit pressures), with factors >= 0
    edges: np.ndarray
    # (k, n_segments): directions of the Tresca part, with factors from -limits to limits
    segments: np.ndarray
    limits: np.ndarray  # (n_segments,)

    def least_unbalanced(self, work: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the smallest sum of |work (k,) left unbalanced|, and the motion (k,) on which it
        is done."""
        k, n_edges = self.edges.shape
        # without linear programmes, whose import takes a tenth of a first small solve: one motion is
        # balanced by any edge that works against the load, or as far as the Tresca part resists
        if k == 1:
            balanced = (self.edges[0] * np.sign(work) < -checks.SIX_DIGITS).any()
            unbalanced = abs(work[0]) - np.abs(self.segments[0]) @ self.limits
            return 0.0 if balanced else max(float(unbalanced), 0.0), np.sign(work)
        from scipy.optimize import linprog

        # least sum of the parts >= 0 of an unbalanced force, on each motion one in either direction,
        # that balance the work together with the contact forces
        columns = np.hstack([self.edges, self.segments, np.eye(k), -np.eye(k)])
        bounds = np.zeros((columns.shape[1], 2))
        bounds[:, 1] = np.inf
        bounds[n_edges : n_edges + len(self.limits)] = np.column_stack([-self.limits, self.limits])
        cost = np.zeros(columns.shape[1])
        cost[-2 * k :] = 1.0
        result = linprog(
            cost, A_eq=columns, b_eq=-work, bounds=cast("Any", bounds), method="highs-ds"
        )
        if not result.success:
            raise RuntimeError(
                f"the linear programme of the rigid-body statics failed: {result.message}"
            )
        return float(cast("float", result.fun)), -result.eqlin.marginals  # the multipliers

    def leaves_unbalanced(self, motion: np.ndarray, work: np.ndarray) -> bool:
        """Return whether no admissible force balances ``work`` (k,) on this ``motion`` (k,)."""
        if (motion @ self.edges < -checks.SIX_DIGITS).any():
            return False
        resistance = np.abs(motion @ self.segments) @ self.limits
        return float(motion @ work - resistance) > checks.SIX_DIGITS


def _contact_forces(body: _Body, limit: np.ndarray, friction: np.ndarray) -> _Forces:
    """Return the forces that nodal Tresca limits (n_contact,), in units of the load, and friction
    coefficients (n_contact,) admit."""
    problem = body.problem
    dim = problem.dim
    contact = problem.contact
    # which contact nodes are on the body, and their places among its nodes, which are ascending
    place_in_body = np.searchsorted(body.nodes, contact.nodes)
    on_body = place_in_body < len(body.nodes)
    on_body[on_body] = body.nodes[place_in_body[on_body]] == contact.nodes[on_body]
    frames = frames_of(problem)[on_body]
    at_contact = body.motions.reshape(len(body.nodes), dim, -1)[place_in_body[on_body]]
    local_motions = np.einsum("nij,njk->nik", frames, at_contact)
    normal = local_motions[:, 0]
    tangential = local_motions[:, 1:]
    # a limit may be infinite, which a programme cannot take: a million loads are enough
    limit = np.minimum(limit[on_body], 1 / checks.SIX_DIGITS)
    friction = friction[on_body]
    k = body.motions.shape[1]
    corners, directions, half_length = _friction_polygon(dim)
    # with friction the cone -p n + t at p = 1: an edge for each corner t of the polygon about the
    # circle of radius mu
    rubs = friction > 0
    rubbing = friction[rubs, None, None] * np.einsum("ct,ntk->nck", corners, tangential[rubs])
    cones = (rubbing - normal[rubs, None]).reshape(-1, k)
    # without friction -p n, at each obstacle: scalar problems may have two, or none in front
    has_obstacle = np.isfinite(contact.gaps[on_body])
    behind = normal[np.isfinite(contact.opposite_gaps[on_body])] if dim == 1 else normal[:0]
    edges = np.concatenate([-normal[~rubs & has_obstacle], behind, cones])
    # Tresca's friction is a sum of segments, whether a node touches or not
    is_limited = limit > 0
    segments = np.einsum("st,ntk->nsk", directions, tangential[is_limited]).reshape(-1, k)
    return _Forces(edges.T, segments.T, np.repeat(limit[is_limited] * half_length, len(directions)))


def _motion_to_blame(
    body: _Body, forces: _Forces, work: np.ndarray, motion: np.ndarray
) -> np.ndarray:
    """Return the free motion (k,) that a message blames for unbalanced ``work`` (k,), of a load of size 1,
    of which ``motion`` is one: if possible a motion along or about a coordinate axis; else one that
    opens contact, which even unlimited friction does not hold; else the part of ``motion`` that
    slides, or ``motion`` itself if the load does no work, up to SIX_DIGITS, on this part."""
    on_axis = _unbalanced_axis_motion(body, forces, work)
    if on_axis is not None:
        return on_axis
    n = len(body.problem.contact)
    # unlimited friction, whether a node is pressed or not: an infinite limit of Tresca's law
    stuck = _contact_forces(body, limit=np.full(n, np.inf), friction=np.zeros(n))
    unbalanced, opening = stuck.least_unbalanced(work)
    if unbalanced > checks.SIX_DIGITS:
        return _axis_motion_or(body, stuck, work, opening)
    # unlimited friction would hold the body, so it slides. The multipliers move along an edge of a
    # friction cone, which opens contact: the motion to blame is their part that keeps contact, on
    # which no pressure works; the rows of ``sliding`` are an orthonormal basis of such motions
    sliding = orthonormal_null_combinations(stuck.edges.T, checks.SIX_DIGITS)
    slide = sliding.T @ (sliding @ motion)
    return slide if slide @ work > checks.SIX_DIGITS else motion


def _friction_polygon(dim: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the corners (n, dim - 1) of the polygon about the unit disc, and the directions
    (n/2, dim - 1) and the half length of the segments whose sum it is. Scalar problems have no tangents:
    no columns."""
    if dim < 3:  # the disc is the segment from -1 to 1
        return np.array([[1.0], [-1.0]])[:, : dim - 1], np.array([[1.0]])[:, : dim - 1], 1.0
    angles = np.pi * np.arange(2 * _SEGMENTS) / _SEGMENTS
    half_angle = 0.5 * np.pi / _SEGMENTS
    corners = np.column_stack([np.cos(angles + half_angle), np.sin(angles + half_angle)]) / np.cos(
        half_angle
    )
    return (
        corners,
        np.column_stack([np.cos(angles), np.sin(angles)])[:_SEGMENTS],
        float(np.tan(half_angle)),
    )


def _free_axis_motions(body: _Body) -> np.ndarray:
    """Return the coefficients (n, k) of the free motions along and about coordinate axes, each in both
    directions."""
    problem = body.problem
    columns = []
    for _, nodes in body.pieces:
        for motion in _axis_motions(problem, nodes)[0].T:
            field = np.zeros((problem.n_nodes, problem.dim))
            field[nodes] = motion.reshape(len(nodes), -1)
            columns.append(problem.relative(field)[body.nodes].reshape(-1))
    motions = np.stack(columns, axis=1)
    # the columns of body.motions are orthogonal, of length sqrt(n_nodes)
    coefficients = body.motions.T @ motions / len(body.nodes)
    # those that are combinations of free motions, up to rounding
    free = np.abs(body.motions @ coefficients - motions).max(axis=0) <= 1e-8
    return np.concatenate([coefficients[:, free].T, -coefficients[:, free].T])


def _axis_motion_in_span(body: _Body, free: np.ndarray) -> np.ndarray:
    """Return a motion (k,) along or about a coordinate axis in the span of the orthonormal rows of
    ``free`` (n, k), or the first row if there is none."""
    in_span = [
        motion
        for motion in _free_axis_motions(body)
        if np.linalg.norm(motion - free.T @ (free @ motion)) <= checks.SIX_DIGITS
    ]
    return (in_span or free)[0]


def _axis_motions(
    problem: DiscreteProblem, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the motions (n * dim, m) of some nodes along axes through their centre, and about these if
    the problem has coordinates; the centre (dim,); and the size, m: the distance from the centre at which
    a rotation moves a node by 1."""
    dim = problem.dim
    centre = np.zeros(problem.dim)
    size = 1.0
    columns = [np.tile(axis, (len(nodes), 1)) for axis in np.eye(dim)]
    if problem.coordinates is not None and dim > 1:
        x = problem.coordinates[nodes]
        centre = x.mean(axis=0)
        size = float(np.ptp(x, axis=0).max())
        columns += rotations((x - centre) / size, np.eye(dim))
    return np.stack([column.reshape(-1) for column in columns], axis=1), centre, size


def _unbalanced_axis_motion(body: _Body, forces: _Forces, work: np.ndarray) -> np.ndarray | None:
    """Return a motion (k,) along or about a coordinate axis that the forces leave unbalanced, None if
    there is none."""
    return next((c for c in _free_axis_motions(body) if forces.leaves_unbalanced(c, work)), None)


def _axis_motion_or(
    body: _Body, forces: _Forces, work: np.ndarray, motion: np.ndarray
) -> np.ndarray:
    """Return an unbalanced motion along or about a coordinate axis, or else ``motion`` (k,)."""
    on_axis = _unbalanced_axis_motion(body, forces, work)
    return motion if on_axis is None else on_axis


def _axis(direction: np.ndarray) -> str:
    """Return the name of the coordinate axis along a direction (dim,), with its sign; of other directions
    the unit vector as text."""
    unit = direction / np.linalg.norm(direction)
    i = int(np.argmax(np.abs(unit)))
    if abs(unit[i]) > 1 - 1e-9:
        return ("-" if unit[i] < 0 else "") + "xyz"[i]
    return _vector(unit, 1.0)


def _vector(values: np.ndarray, size: float) -> str:
    """Return rounded coordinates as text; what is zero to rounding is printed as 0."""
    return "(" + ", ".join(f"{0.0 if abs(v) < 1e-6 * size else v:.4g}" for v in values) + ")"


#: dofs, and those at contact nodes, up to which the estimate costs next to nothing
_SMALL, _SMALL_CONTACT = 1500, 200


@remembered_of_structure
def critical_friction(problem: DiscreteProblem) -> np.ndarray:
    """Return the critical coefficients (n_contact,) of contact nodes that touch alone, infinite at nodes
    that supports hold in part; NaN for bodies that contact holds."""
    dim = problem.dim
    n = len(problem.contact)
    system, condensed = eliminated(problem)
    eigenvalues, eigenvectors = np.linalg.eigh(condensed.matrix)
    # a motion that only contact holds has no compliance: its stiffness is zero but for rounding
    is_regular = len(condensed.factors.order) == problem.n_dofs
    if not is_regular or not eigenvalues[0] > 1e-10 * eigenvalues[-1]:
        return np.full(n, np.nan)
    # C of each node alone, and K = 1/C below
    compliance = (eigenvectors / eigenvalues) @ eigenvectors.T
    blocks = compliance.reshape(n, dim, n, dim)[np.arange(n), :, np.arange(n), :]
    free = ~system.fixed.reshape(-1, dim)[problem.contact.nodes].any(axis=1)
    critical = np.full(n, np.inf)
    critical[free] = critical_coefficients(np.linalg.inv(blocks[free]))
    critical.flags.writeable = False
    return critical


def warn_of_several_solutions(grids: Grids) -> None:
    """Warn where the friction of a node exceeds the critical coefficient on the coarsest grid. Where
    that is not cheap, or contact holds bodies, it is compared with a larger bound: the coefficient
    on the finest grid with all other nodes held."""
    finest = grids.finest.discrete
    _, friction = finest.law.bounds(len(finest.contact))
    if not friction.any():
        return
    examined = grids[0].discrete_or_none
    critical = np.array([np.nan])
    if (
        examined is not None
        and examined.n_dofs <= _SMALL
        and 0 < len(examined.contact) * examined.dim <= _SMALL_CONTACT
    ):
        # a singular interior is refused elsewhere
        with suppress(ValueError, np.linalg.LinAlgError):
            critical = critical_friction(examined)
    if examined is None or np.isnan(critical).any():
        examined = finest
        critical = critical_coefficients(contact_blocks(examined))
    # the least at any pressure and slip: advise_on_law examines those of the result
    warn_where_steep(
        sampled_friction(examined.law, len(examined.contact)).min(axis=0), critical, "friction"
    )
