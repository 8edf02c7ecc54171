r"""Certificate: whether a displacement solves the contact problem, recomputed from the raw
matrices.

Nothing here comes from the solvers or their frames but arithmetic: of small blocks, and an interior
point method on a small dense matrix, whose result is measured afterwards. There are products with
the stored matrix, unit normals n and projections I - n n' in Cartesian components. With :math:`r =
A u - b`, the claimed contact forces :math:`f = -p\,n + f_t`, their bound :math:`s + \mu p` and the
slip :math:`\tau` it measures

.. math:: r - f = 0, \quad u_n \le g_0, \quad p \ge 0, \quad p\,(g_0 - u_n) = 0, \quad
          |f_t| \le s + \mu p, \quad (s + \mu p)\,|\tau| + f_t \cdot \tau = 0,

prescribed values, the claimed states, the balance of all forces, and the energy error
(:mod:`adaptmg.solver.energy_error`). Forces are relative to loads and reactions, lengths to the
largest displacement, energies to u'Au: never to a lifted nodal jump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import in_html_lines, shortened
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.block_rows import BlockRows
from adaptmg.discrete.coordinates import from_frames
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.discrete.volumes import NO_PRESSURES
from adaptmg.mesh.arrays import mask_of
from adaptmg.solver.aggregates import (
    Aggregates,
    ContactValues,
    aggregates_of,
    change_with_free_status,
)
from adaptmg.solver.energy_error import FrozenStatus, correction


@dataclass(frozen=True, repr=False)
class Certificate:
    """By how much each condition of the contact problem is violated. Printing it shows a table.

    Attributes
    ----------
    lines : tuple of :class:`adaptmg.solver.Condition`
        'equilibrium' (of free dofs, under the claimed contact forces), 'volumes' (of nearly
        incompressible bodies with smoothed elements: mean volume strains against the pressures of
        groups), 'prescribed values', 'penetration', 'tension', 'complementarity' (the smaller of
        pressure and gap, each in its scale), 'friction bound', 'slip direction' (the work of
        friction on its bound and opposite to the slip, less that of the claimed friction), 'slip
        along the force' (weighted by force), 'open, touching' (forces at open nodes), 'touching,
        open' (gaps at touching nodes), 'slip, sticking' (slip at sticking nodes), 'balance' (sum of
        loads and all reactions). Of results on meshes also what shares nothing with the assembly:
        'stiffness' (the nodal forces of an affine field against its tractions and springs), 'loads'
        (force and moment on each body against what is posed), 'measures' (boundary masses of
        contact nodes against those of their facets), 'bodies' (force and moment of loads, springs,
        supports, ties and contact on each body, those on masters opposite to those on slaves) and
        'stresses' (of linear elements, against forces of supports, ties and contact).
    energy_error : float
        Estimated ||u - u_h||_A / ||u||_A with the contact status held, by a few preconditioned
        steps: mostly 0 to 10 % too large, seldom too small. Two steps suffice where the estimate is
        at most .6 rtol, which may then be half too large. Where the corrected displacement
        contradicts the status, the status may change (:mod:`adaptmg.solver.aggregates`). With
        ``bound=True`` by a factorisation, and the status stays: an upper bound of the distance to the
        solution with this status, equal to it where touching nodes are on the obstacle and sticking
        ones do not slip, and infinite where the status leaves a motion free that is loaded.
    energy_rounding : float
        The part of it that rounding explains: of the displacement, and where the error is above
        rtol though all forces balance to the last digits, of the residual, too, measured: some
        1e-16 times the condition of the matrix.
    exact_energy : bool
        Whether a factorisation was made.
    force, displacement, energy_norm : float
        The scales of the lines: N, m, and sqrt(u'Au) (sqrt(N m)), of u without what initial strains
        expand freely; in 2D per metre of thickness.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> result.certificate().energy_error < 1e-7
    True
    """

    lines: tuple[Condition, ...]
    energy_error: float
    energy_rounding: float
    exact_energy: bool
    force: float
    displacement: float
    energy_norm: float

    #: lines beyond the first multiple of rtol, and an energy error beyond the second, contradict a solver that says it
    #: has converged
    #: FACTOR: of 870 random solves to 1e-6 that converge the largest line is 8.6 times rtol, the next 6.2
    FACTOR, ENERGY_FACTOR = 20.0, 3.0
    #: relative violations that rounding may excuse at most: what has run away does not balance its forces as well
    #: springs a millionth as stiff as their body leave 4.8e-6 (test_supports): at 1e-6 they are refused; half and
    #: twice change none of 70 solves of soft springs, slender, floating and random bodies
    MOST_ROUNDING = 1e-5

    def __getitem__(self, name: str) -> Condition:
        for line in self.lines:
            if line.name == name:
                return line
        raise KeyError(f"no line {name!r}; there are {', '.join(line.name for line in self.lines)}")

    @property
    def worst(self) -> Condition:
        """Return the condition that is violated most, relative to its scale."""
        return max(
            self.lines, key=lambda line: np.inf if np.isnan(line.relative) else line.relative
        )

    def contradictions(self, rtol: float, energy_factor: float = ENERGY_FACTOR) -> tuple[str, ...]:
        """Return the names of the conditions that are violated by more than a displacement accurate
        to ``rtol`` violates them."""
        checks.nonnegative("rtol", rtol)
        checks.nonnegative("energy_factor", energy_factor)
        rows = [
            (line.name, line.relative, line.limit or self.FACTOR * rtol, line.rounding)
            for line in self.lines
        ]
        of_energy = "energy error", self.energy_error, energy_factor * rtol, self.energy_rounding
        names = [
            name
            for name, value, allowed, rounding in (*rows, of_energy)
            if not value <= max(allowed, min(rounding, self.MOST_ROUNDING))
        ]
        return tuple(names)

    def __repr__(self) -> str:
        return shortened(str(self))

    def _repr_html_(self) -> str:
        return in_html_lines(str(self))

    def __str__(self) -> str:
        rows = [
            f"Certificate: forces relative to {self.force:.3g} N, lengths to {self.displacement:.3g} m, energy to "
            f"{self.energy_norm**2:.3g} N m",
            f"{'':<22} {'largest':>9} {'in all':>9} {'':<4} {'relative':>9}",
        ]
        rows += [
            f"{line.name:<22} {line.largest:>9.2e} {line.total:>9.2e} {line.unit:<4} {line.relative:>9.2e}"
            for line in self.lines
        ]
        how = "a bound for this contact status" if self.exact_energy else "estimated"
        return "\n".join(
            [
                *rows,
                f"{'energy error':<22} {'':>9} {'':>9} {'':<4} {self.energy_error:>9.2e}  ({how})",
            ]
        )


@one_blas_thread()
def certify(
    problem: DiscreteProblem,
    displacement: np.ndarray,
    contact: ContactClaims,
    bound: bool = False,
    rtol: float = 0.0,
    pressures: np.ndarray = NO_PRESSURES,
    residual: np.ndarray | None = None,
    on_mesh: ConditionsOnMesh | None = None,
) -> Certificate:
    """Check a displacement (n_nodes, dim), m, and the contact forces and states that go with it; of a
    problem with volumes also their ``pressures`` (n_groups,), Pa. ``residual`` (n_dofs,): b - A w, N, if
    it was computed. ``on_mesh`` returns the lines that need the mesh
    (:mod:`adaptmg.solver.closed_forms`).

    The energy error is estimated by iteration with the contact status held, in fewer steps where it
    is small against ``rtol``; where the corrected displacement contradicts this status, with a status
    that may change. With ``bound`` it is bounded by a factorisation, and the status stays: that is
    what :meth:`Evidence.energy_error` does without aggregates."""
    # a diverged displacement overflows: its lines are inf or nan, which contradict every tolerance
    with np.errstate(over="ignore", invalid="ignore"):
        evidence = Evidence(
            problem, np.asarray(displacement, dtype=np.float64), contact, pressures, residual
        )
        # where all is fixed there are no motions for aggregates, and nothing to factorise
        aggregates = None if bound or problem.fixed.all() else aggregates_of(problem)
        energy_error, energy_rounding = evidence.energy_error(aggregates, rtol)
        lines = evidence.lines() if on_mesh is None else (*evidence.lines(), *on_mesh(evidence))
    return Certificate(
        lines=lines,
        energy_error=0.0 if evidence.idle else energy_error,  # nothing strains: it is rounding
        energy_rounding=energy_rounding,
        exact_energy=bound,
        force=evidence.force,
        displacement=evidence.length,
        energy_norm=evidence.energy_norm,
    )


#: returns the lines of a certificate that need the mesh and the posed problem
ConditionsOnMesh = Callable[["Evidence"], tuple["Condition", ...]]

_OPEN, _SLIP, _STICK = 0, 1, 2
#: share of rtol below which an energy error is negligible; :mod:`adaptmg.solver.energy_error` takes fewer steps for
#: errors up to some multiples of it
#: half changes 0 of 119 solves, paths and loops, twice 3; cycles 691, 691, 694 (campaign constants)
_NEGLIGIBLE = 0.1
#: a status is wrong if a node penetrates by more than this share of the largest correction, or pulls by more than this
#: share of the largest pressure
_WRONG = 0.05
#: residuals of random signs that measure what error rounding leaves: the largest of 4 is 1.3 to 7 times the error at
#: which methods came to rest (beams of 50 to 147 : 1), of 2 half of that
_SAMPLES = 4
#: multiple of a change of the status that may still be missing after it
#: 0 and no limit change none of 316 random solves; 72 were watched, and no certificate comes here: it is for
#: displacements that are far from their status
_FOUND = 2.0
#: compliance of a surface, over that of its node, above which it counts as a spring, below as rigid
_STIFF = checks.SIX_DIGITS
_EPSILON = float(np.finfo(float).eps)


class ContactClaims(Protocol):
    """The claims of a result about its contact nodes; see
    :class:`adaptmg.solver.examine.ContactResult`."""

    @property
    def node(self) -> np.ndarray: ...

    @property
    def frames(self) -> np.ndarray: ...

    @property
    def force_n(self) -> np.ndarray: ...

    @property
    def force_t(self) -> np.ndarray: ...

    @property
    def state(self) -> np.ndarray: ...

    @property
    def master_node(self) -> np.ndarray: ...

    @property
    def master_force(self) -> np.ndarray: ...


@dataclass(frozen=True)
class Condition:
    """One line of a certificate: by how much a condition is violated.

    Attributes
    ----------
    name : str
        One of those that :class:`adaptmg.Certificate` lists.
    largest, total : float
        At one node, and over all: the Euclidean norm, of energies the sum; in ``unit``.
    unit : str
        Empty for a number.
    relative : float
        ``largest`` or ``total`` over the scale of the line.
    rounding : float
        The part of ``relative`` that rounding explains.
    limit : float
        The largest ``relative`` that passes, whatever the tolerance; 0: by the tolerance.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> result.certificate()["penetration"].unit
    'm'
    """

    name: str
    largest: float
    total: float
    unit: str
    relative: float
    rounding: float = 0.0
    limit: float = 0.0


class Evidence:
    """The quantities that the lines are made from. Forces of coupled bodies are those of the
    bodies, not of relative coordinates."""

    def __init__(
        self,
        problem: DiscreteProblem,
        displacement: np.ndarray,
        contact: ContactClaims,
        pressures: np.ndarray = NO_PRESSURES,
        residual: np.ndarray | None = None,
    ) -> None:
        """Measure a displacement (n_nodes, dim), m, with the ``pressures`` (n_groups,), Pa, of volumes;
        ``residual`` (n_dofs,): f - B'p - A w, N, if it is known."""
        self.u = displacement.reshape(problem.n_nodes, problem.dim)  # of the bodies
        if problem.dim == 1:
            # of two obstacles the conditions are those of the nearest
            moved = self.u[problem.contact.nodes]
            problem = problem.posing(contact=problem.contact.facing(moved))
        self.problem = problem
        self.contact = contact
        self.pressures = pressures
        self.nodes = problem.contact.nodes
        self.normals = problem.contact.normals
        self.unknowns = problem.relative(self.u)  # w, between bodies relative
        load = problem.volumes.balanced(problem.load, pressures)
        self.residual = (
            load - problem.rows.times(self.unknowns.reshape(-1)) if residual is None else residual
        )
        # w'Aw = w . (f - r); where bodies expand freely only the stresses have energy
        energy = _sum(self.unknowns, load - self.residual) + problem.volumes.energy(pressures)
        self.energy_norm = float(
            np.sqrt(problem.stress_energy(self.unknowns.reshape(-1), max(energy, 0.0)))
        )
        self._measure_contact()
        self._subtract_claims()
        self._set_scales()

    def _measure_contact(self) -> None:
        """Compute the claimed forces, the gaps to the deformed surfaces, the slips and the bounds of
        friction."""
        contact = self.contact
        problem = self.problem
        # f = -p n + f_t
        self.claimed = from_frames(
            contact.frames, np.column_stack([-contact.force_n, contact.force_t])
        )
        self.pressure = -np.einsum("nd,nd->n", self.claimed, self.normals)
        self.friction = self.claimed + self.pressure[:, None] * self.normals
        gap, self.slip = self._kinematics()
        self.stiffness = np.einsum("nii->ni", problem.rows.diagonal_blocks(self.nodes)).max(axis=1)
        self.gap, self.compliance = self._with_surface_layer(gap)
        self.limit, _ = problem.law.bounds(len(self.nodes))
        slip = np.linalg.norm(self.slip, axis=1)
        self.coefficient = problem.friction_at(self.pressure, slip)
        # s + mu p
        self.bound = self.limit + self.coefficient * np.maximum(self.pressure, 0.0)

    def _subtract_claims(self) -> None:
        """Compute the forces that neither loads nor ties nor claimed contact forces explain.

        ===========  ========================  =====================================================
        attribute    shape, coordinates        forces
        ===========  ========================  =====================================================
        tying        (n_dofs,), relative       A u - b at tied dofs: a tie holds with what it needs
        unexplained  (n_nodes, dim), bodies    other A u - b, minus the claims on slaves and masters
        at_contact   (n_contact, dim), bodies  unexplained at contact nodes
        in_supports  (n_nodes, dim), bodies    unexplained along what supports hold
        left         (n_nodes, dim), bodies    unexplained along what is free: it must vanish
        ===========  ========================  =====================================================
        """
        problem = self.problem
        tied = problem.fixed & ~problem.held
        # zero without memory where nothing is tied
        self.tying = np.broadcast_to(0.0, problem.n_dofs)
        if tied.any():
            self.tying = np.where(tied, -self.residual, 0.0)
            # along what is held supports bear the force
            problem.inclined.remove_held(self.tying)
        borne = -self.residual - self.tying
        self.unexplained = problem.physical_forces(borne).reshape(self.u.shape)
        self.unexplained[self.nodes] -= self.claimed
        np.subtract.at(self.unexplained, self.contact.master_node, self.contact.master_force)
        self.at_contact = self.unexplained[self.nodes]
        self.left = problem.free_part(self.unexplained).reshape(self.u.shape)
        self.in_supports = self.unexplained - self.left

    def _set_scales(self) -> None:
        """Compute the scales of forces and displacements, and the levels of rounding."""
        problem = self.problem
        diagonal = problem.rows.diagonal().reshape(self.u.shape)
        self.internal = _norm(problem.load - self.residual)
        # with ties: in a periodic cell no other forces act, and these are not rounding
        acting = (
            problem.physical_forces(problem.load),
            self.in_supports,
            self.claimed,
            self.tying,
        )
        self.force = max(map(_norm, acting))
        self.total = float(max(np.abs(forces).sum() for forces in acting))
        self.length = float(np.abs(self.u).max())
        # a row sums terms of the size of its diagonal times its displacement. Of 90 linear problems with 36 to
        # 7021 unknowns sparse LU leaves residuals of .5 to 2.2 and energy errors of .6 to 4.1 times these
        # sums and the unit of rounding; cycles sum more often
        terms = np.abs(diagonal * self.u)
        self.rounding = 8 * _EPSILON * _norm(terms)
        self.energy_rounding = 32 * _EPSILON * float(np.sqrt(_sum(terms, np.abs(self.u))))
        # whether the forces of all stresses are rounding: supports move the bodies, and nothing strains
        # them. As Sizes.nothing_strains, with its factors: nothing here comes from the solvers
        moved = float(np.abs(problem.fixed_values).max(initial=0.0))
        self.idle = (
            moved > 0.0 and self.internal <= 1e3 * self.rounding and self.length <= 10 * moved
        )

    def lines(self) -> tuple[Condition, ...]:
        """Return all conditions."""
        of_volumes = self.problem.volumes.conditions(self.unknowns.reshape(-1), self.pressures)
        lines = (
            self.equilibrium(),
            *[self._forces(name, forces) for name, forces in of_volumes.items()],
            self.prescribed(),
            *self.normal(),
            *self.tangential(),
            *self.states(),
            self.balance(),
        )
        if not self.idle:
            return lines
        # where all forces are rounding they are no scale: ratios count as zero, and so do forces of
        # the size of rounding
        return tuple(
            replace(line, relative=0.0)
            if not line.unit or (line.unit != "m" and line.largest <= self.rounding)
            else line
            for line in lines
        )

    def _kinematics(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the gap (n,) and slip (n, dim) against the obstacle, or the other body."""
        problem = self.problem
        moved = problem.apart(self.u)
        u_n = np.einsum("nd,nd->n", moved, self.normals)
        # the tangential part of u - reference
        along = moved - problem.contact.slip_reference
        slip = along - np.einsum("nd,nd->n", along, self.normals)[:, None] * self.normals
        return problem.contact.gaps - u_n, slip

    def _with_surface_layer(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gaps (n,) of surfaces that give way, gap(p) = g + e p^(1/m) at the pressures p, and
        the derivatives (n,) of gap(p).

        Where a surface is softer than its node, gap'(p) d > 1 with the stiffness d, a change of p by
        rounding moves it far. There both come from the tangent at the pressure q that closes the gap,
        gap(q) = 0: they are gap'(q) (p - q) and gap'(q)."""
        scale = self.problem.contact.compliance
        exponent = self.problem.contact.exponent
        pressure = np.maximum(self.pressure, 0.0)
        # without a force the derivative is infinite
        least = checks.ROUNDING * (pressure.max(initial=0.0) or 1.0)

        def derivative(force: np.ndarray) -> np.ndarray:
            # of e p^(1/m): e p^(1/m - 1) / m
            return scale * np.maximum(force, least) ** (1 / exponent - 1) / exponent

        depth = np.maximum(-gap, 0.0)
        soft = (derivative(pressure) * self.stiffness > 1) & (depth > 0)
        # q = (-g / e)^m
        closing = np.divide(depth, scale, out=np.zeros_like(depth), where=soft) ** exponent
        slope = derivative(np.where(soft, closing, pressure))
        compressed = gap + scale * pressure ** (1 / exponent)
        return np.where(soft, slope * (pressure - closing), compressed), slope

    @property
    def scaled_gap(self) -> np.ndarray:
        """Return the gaps g (n,), m, negative where a node penetrates; in front of surfaces that yield by
        a power of the force g / max(1, F e / l), with the derivative e of the compression, the scale F
        of forces and the scale l of lengths. The force g / e closes the gap: where it is small next to
        F, so is the violation."""
        length = self.length or 1.0
        share = length / np.maximum(length, self.force * self.compliance)
        return np.where(self.problem.contact.exponent > 1, share * self.gap, self.gap)

    def _forces(self, name: str, forces: np.ndarray) -> Condition:
        """Return the line of forces, N, of any shape, that should vanish, by their norm over the scale of
        forces."""
        total = float(np.linalg.norm(forces))
        return Condition(
            name,
            largest=float(np.abs(forces).max(initial=0.0)),
            total=total,
            unit="N",
            relative=ratio(total, self.force),
            rounding=ratio(self.rounding, self.force),
        )

    def _lengths(self, name: str, lengths: np.ndarray) -> Condition:
        """Return the line of lengths (n,), m, that should vanish, by the largest over the scale of lengths;
        displacements are rounded in their last digits."""
        largest = float(np.abs(lengths).max(initial=0.0))
        return Condition(
            name,
            largest=largest,
            total=float(np.linalg.norm(lengths)),
            unit="m",
            relative=ratio(largest, self.length),
            rounding=16 * _EPSILON,
        )

    def _works(self, name: str, works: np.ndarray, scale: float) -> Condition:
        """Return the line of works (n_contact,) that should vanish, N m, by their sum over a ``scale`` of
        forces, N, times that of lengths."""
        total = float(works.sum())
        # a work is a force times a length: the rounding of both
        rounding = ratio(self.rounding, self.force) + 16 * _EPSILON
        # a scale that cannot vanish: bodies may part, or slip without friction
        scale = max(scale, self.force) * self.length
        return Condition(
            name,
            largest=float(works.max(initial=0.0)),
            total=total,
            unit="N m",
            relative=ratio(total, scale),
            rounding=rounding,
        )

    def equilibrium(self) -> Condition:
        """Return the forces at free dofs that neither loads nor claimed contact forces explain."""
        return self._forces("equilibrium", self.left)

    def prescribed(self) -> Condition:
        """Return the deviations from the prescribed values."""
        missed = self.unknowns - self.problem.fixed_values.reshape(self.u.shape)
        along_held = missed - self.problem.free_part(missed).reshape(missed.shape)
        lengths = np.linalg.norm(along_held[self.problem.fixed_nodes()], axis=1)
        return self._lengths("prescribed values", lengths)

    def normal(self) -> tuple[Condition, Condition, Condition]:
        """Return penetration, tension, complementarity."""
        gap = self.scaled_gap
        # the contact force along n that equilibrium requires, claimed and unexplained; the claimed one
        # is -p
        required = np.einsum("nd,nd->n", self.at_contact, self.normals) - self.pressure
        tension = np.maximum(np.maximum(required, -self.pressure), 0.0)
        # each in its scale: a rounding force times a gap of a thousand displacements is not a violation
        smaller = np.maximum(
            np.minimum(self.pressure / (self.force or 1.0), gap / (self.length or 1.0)), 0.0
        )
        complementarity = Condition(
            "complementarity",
            largest=float(smaller.max(initial=0.0)),
            total=_norm(smaller),
            unit="",
            relative=_norm(smaller),
            rounding=ratio(self.rounding, self.force) + 16 * _EPSILON,
        )
        return (
            self._lengths("penetration", np.maximum(-gap, 0.0)),
            self._forces("tension", tension),
            complementarity,
        )

    def tangential(self) -> tuple[Condition, Condition, Condition]:
        """Return friction beyond its bound, friction that is not on its bound and opposite to the slip, and
        slip along the friction.

        A node whose friction drives its slip violates the last two. The second one is over the sum of
        all bounds: where bounds elsewhere are large, only the third one finds this node."""
        size = np.linalg.norm(self.friction, axis=1)
        slip = np.linalg.norm(self.slip, axis=1)
        work = np.einsum("nd,nd->n", self.friction, self.slip)
        excess = np.maximum(size - self.bound, 0.0)
        # (s + mu p) |tau| + f_t . tau
        short_of_bound = np.maximum(self.bound * slip + work, 0.0)
        if self.idle:
            # all forces are rounding, whose direction means nothing: friction of this size may have any
            work = work - self.rounding * slip
        # works over the scale of forces, a norm over all nodes, not over the force of the node: open nodes
        # slip freely, and their force may be rounding
        same_way = np.maximum(work, 0.0) / (self.force or 1.0)
        return (
            self._forces("friction bound", excess),
            self._works("slip direction", short_of_bound, self.bound.sum()),
            self._lengths("slip along the force", same_way),
        )

    def states(self) -> tuple[Condition, Condition, Condition]:
        """Return the forces, gaps and slips that contradict the claimed states."""
        state = np.asarray(self.contact.state)
        slip = np.linalg.norm(self.slip, axis=1)
        return (
            self._forces(
                "open, touching", np.where(state == _OPEN, np.maximum(self.pressure, 0.0), 0.0)
            ),
            self._lengths(
                "touching, open", np.where(state != _OPEN, np.maximum(self.scaled_gap, 0.0), 0.0)
            ),
            self._lengths("slip, sticking", np.where(state == _STICK, slip, 0.0)),
        )

    def balance(self) -> Condition:
        """Return the sum of all forces that act: loads, supports, claimed contact forces and
        foundations. It is that of the unexplained forces at free dofs, as stresses add nothing to it
        (in axisymmetry along the axis)."""
        sums = np.einsum("nd->d", self.left)
        total = float(np.linalg.norm(sums))
        # |sum of n numbers| <= sqrt(n) times their Euclidean norm
        rounding = self.rounding * np.sqrt(self.problem.n_nodes)
        return Condition(
            "balance",
            largest=float(np.abs(sums).max()),
            total=total,
            unit="N",
            relative=ratio(total, self.total),
            rounding=ratio(rounding, self.total),
        )

    def energy_error(self, aggregates: Aggregates | None, rtol: float = 0.0) -> tuple[float, float]:
        """Return the relative energy error, and the part of it that rounding explains: estimated with
        ``aggregates``, with a status that may change where it is wrong; without them by a factorisation
        for the status of the displacement."""
        conditions = ContactValues(self.gap, self.slip, self.pressure, self.friction)
        forces = self.problem.relative_forces(self.unexplained.reshape(-1)).reshape(self.u.shape)
        # an energy: the square of a norm
        negligible = (_NEGLIGIBLE * rtol * self.energy_norm) ** 2
        error, wrong = self._error_with_status_held(
            conditions, self.unknowns, forces, aggregates, negligible
        )
        if wrong and aggregates is not None and not error <= self.energy_rounding:
            error = self._with_changed_status(conditions, error, aggregates)
        rounding = self.energy_rounding
        # methods stop improving with forces of .07 to 1.2 times the rounding (beams of 50 to 147 : 1). An error
        # of the size of the solution is not rounding
        balanced = _norm(self.left) <= self.rounding
        if (
            aggregates is not None
            and balanced
            and rtol * self.energy_norm < error < self.energy_norm
        ):
            rounding = max(rounding, self._attainable(conditions, aggregates))
        return ratio(error, self.energy_norm), ratio(rounding, self.energy_norm)

    def _attainable(self, conditions: ContactValues, aggregates: Aggregates) -> float:
        """Return the energy error that rounding of the residual leaves: the largest one that residuals
        of the size of rounding and of random signs cause with the contact status held. On slender
        bodies it is large, as the condition of the matrix."""
        matrix = self.problem.matrix
        status = self._nearest_status(conditions, self.unknowns).status
        squares = sparse.bsr_array((matrix.data**2, matrix.indices, matrix.indptr))
        # (n_dofs,): the root of the sum of squares of the terms of a row, times the unit of rounding
        sizes = _EPSILON * np.sqrt(squares @ self.unknowns.reshape(-1) ** 2)
        missed = np.zeros(len(self.problem.volumes))
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (_SAMPLES, len(sizes)))
        energies = [
            correction(
                self.problem,
                status,
                residual=(sizes * sign).reshape(self.u.shape),
                missed=missed,
                aggregates=aggregates,
                negligible=0.0,
                rounding=self.rounding,
            ).energy
            for sign in signs
        ]
        return float(np.sqrt(max(energies)))

    def _error_with_status_held(
        self,
        conditions: ContactValues,
        unknowns: np.ndarray,
        forces: np.ndarray,
        aggregates: Aggregates | None,
        negligible: float = 0.0,
    ) -> tuple[float, bool]:
        """Return a bound of ||u - u_h||_A for ``unknowns`` u (n_nodes, dim) with the contact status held,
        infinite where it leaves a loaded motion free; and whether the corrected displacement contradicts
        this status. ``forces`` (n_nodes, dim), N, are the unexplained ones, A u - b minus the claimed
        contact forces; ``negligible`` is an energy, N m, below which the correction need not be known.

        With the symbols of :mod:`adaptmg.solver.energy_error`: z takes u to v = u + z, which meets the
        constraints of the status, whose lawful contact forces f at u are near the claimed ones: none at
        open nodes but friction that needs no pressure, that of slipping nodes on its bound. Unexplained
        at v is e = A v - b - f. The correction y takes e away, and with the pressures what volume
        strains miss, b v - p/kappa (``missed``). So u_h = v - y, and ||u - u_h||_A <= ||z||_A + ||y||_A."""
        nodes = self.problem.contact.nodes
        normals = self.problem.contact.normals
        nearest = self._nearest_status(conditions, unknowns)
        z = nearest.z
        e = _image(self.problem.rows, z)  # A z, the first part of e
        size_of_z = np.sqrt(max(_sum(z, e), 0.0))
        # the lawful contact forces take the place of the claimed ones
        e += forces
        e[nodes] += conditions.forces(normals) - nearest.lawful
        contact_forces = e[nodes] + nearest.lawful  # A v - b
        missed = self.problem.volumes.missed((unknowns + z).reshape(-1), self.pressures)
        corrected = correction(
            self.problem,
            nearest.status,
            residual=e,  # overwritten
            missed=missed,
            aggregates=aggregates,
            negligible=negligible,
            rounding=self.rounding,
        )
        # gaps and pressures of u_h = v - y: contact nodes have moved by z - y
        gap = conditions.gap - _along(z[nodes] - corrected.moved, normals)
        pressure = -_along(contact_forces - corrected.forces, normals)
        least_gap = -_WRONG * np.linalg.norm(corrected.moved, axis=1).max(initial=0.0)
        largest_pressure = max(pressure.max(initial=0.0), conditions.pressure.max(initial=0.0))
        # a closed node pulls, or an open one penetrates
        pulls = pressure < -_WRONG * largest_pressure
        contradicts = np.where(nearest.closed, pulls, gap < least_gap).any()
        wrong = bool(contradicts) or not np.isfinite(corrected.energy)
        return float(size_of_z + np.sqrt(corrected.energy)), wrong

    def _with_changed_status(
        self, conditions: ContactValues, held_error: float, aggregates: Aggregates
    ) -> float:
        """Return the energy error where the contact status may change: the size of a change in the span
        of the aggregates, with the error that is left after it while the new status is held. What is
        left is orthogonal in the energy to the change, a Galerkin solution. ``held_error`` is the error
        with the present status held."""
        problem = self.problem
        contact = problem.contact
        normals = contact.normals
        residual = problem.residual(np.append(self.unknowns, self.pressures))
        solution = change_with_free_status(
            problem,
            residual,
            claims=conditions,
            stiffness=self.stiffness,
            limit=self.limit,
            friction=self.coefficient,
            compliance=self.compliance,
        )
        if solution is None:
            return held_error
        change, contact_forces = solution
        image = problem.rows.times(change)
        change_size = np.sqrt(max(_sum(change, image), 0.0))
        change = change.reshape(self.u.shape)
        moved = change[contact.nodes]
        approach = _along(moved, normals)
        pressure = -_along(contact_forces, normals)
        # e times the change of the pressure: the surface gives way
        yielding = self.compliance * (
            np.maximum(pressure, 0.0) - np.maximum(conditions.pressure, 0.0)
        )
        changed_conditions = ContactValues(
            gap=conditions.gap - approach + yielding,
            slip=conditions.slip + moved - approach[:, None] * normals,
            pressure=pressure,
            friction=contact_forces + pressure[:, None] * normals,
        )
        # A (u + change) - b, minus the contact forces after the change
        forces = (image - residual).reshape(self.u.shape)
        forces[contact.nodes] -= contact_forces
        error_left, _ = self._error_with_status_held(
            changed_conditions, self.unknowns + change, forces, aggregates
        )
        changed = float(np.hypot(change_size, error_left))
        if error_left <= _FOUND * change_size:
            return changed
        # the aggregates have not found the status: the error is at most that with the status held, or
        # the size of the change
        return min(changed, max(held_error, change_size))

    def _closed(self, conditions: ContactValues) -> np.ndarray:
        """Return which contact nodes touch (n_contact,) bool: those that penetrate, and those where, in
        the measure of the stiffness d of the node, closing the gap g costs less than giving up the
        pressure p: d g^2 < p^2 / d. The gap to a surface of compliance e counts as g / (1 + e d), since a
        smaller force closes it."""
        d = self.stiffness
        pressing = np.maximum(conditions.pressure, 0.0)
        to_close = conditions.gap / (1 + self.compliance * d)
        return (conditions.gap < 0) | (d * to_close**2 < pressing**2 / d)

    def _nearest_status(self, conditions: ContactValues, unknowns: np.ndarray) -> _NearestStatus:
        """Return the status that ``unknowns`` (n_nodes, dim) are nearest to.

        The symbols are those of :mod:`adaptmg.solver.energy_error`, whose correction y solves
        K (I + D) A y + K S y = e: the change z that meets the status, the projection K onto the space
        that keeps it, the stiffness S of friction that turns and of springs, and the map D from the
        forces A y on contact nodes to the friction that grows with their pressure. K
        also projects onto the directions that supports leave free. D and S need no such projection,
        as K is applied after them."""
        problem = self.problem
        dim = problem.dim
        nodes = problem.contact.nodes
        normals = problem.contact.normals
        gap = conditions.gap
        closed = self._closed(conditions)
        on_spring = closed & (self.compliance * self.stiffness > _STIFF)
        on_rigid = closed & ~on_spring
        spring = np.divide(1.0, self.compliance, out=np.zeros_like(gap), where=on_spring)  # 1/e
        pressing = np.maximum(conditions.pressure, 0.0)
        bound = self.limit + np.where(closed, self.coefficient * pressing, 0.0)
        # projections onto what supports leave free
        free = np.eye(dim) - problem.held_spans(nodes)
        claimed = np.einsum("nij,nj->ni", free, conditions.friction)
        friction = self._nearest_friction(conditions.slip, claimed, bound, free)
        # z moves nodes that touch something rigid onto it, takes slips back where this
        # costs less than friction against it, and moves fixed dofs to their prescribed values
        z = np.zeros(unknowns.shape)
        free_slip = np.einsum("nij,nj->ni", free, conditions.slip)
        normal_change = np.where(on_rigid, gap, 0.0)[:, None] * normals
        z[nodes] = normal_change - friction.without_slip[:, None] * free_slip
        missed = problem.fixed_values - unknowns.reshape(-1)
        # this adds the held parts of what is missed. At contact nodes they come on top of the change above:
        # its slips have no held parts, and normals have some only where a support is inclined to the surface
        z += (missed - problem.free_part(missed)).reshape(z.shape)
        # K: tangents I - n n' of nodes that slide, normals n n' of nodes that touch nothing rigid, all
        # projections (n_contact, dim, dim)
        normal_parts = normals[:, :, None] * normals[:, None]
        tangential_parts = np.eye(dim) - normal_parts
        slides = friction.slides[:, None, None] * tangential_parts
        lifts = ~on_rigid[:, None, None] * normal_parts
        others, projections_of_others = _held_elsewhere(problem)
        # S = (B/|tau|)(I - n n' - f f') of friction along f that turns with the slip (3D), n n'/e of
        # springs; D = mu f n' where friction grows with the pressure
        f = friction.direction
        across = (tangential_parts - f[:, :, None] * f[:, None]) * (dim == 3)
        growing = self.coefficient * (friction.slides & closed)
        status = FrozenStatus(
            held=np.append(nodes, others),
            projections=np.concatenate([free @ (slides + lifts) @ free, projections_of_others]),
            nodes=nodes,
            stiffening=friction.turning[:, None, None] * across
            + spring[:, None, None] * normal_parts,
            dragged=growing[:, None, None] * f[:, :, None] * normals[:, None],
        )
        # the pressure p' that closes the gap of a spring, g + e (p' - p) = 0: p' = p - g/e
        pressure = np.where(closed, conditions.pressure, 0.0) - spring * gap
        return _NearestStatus(
            status=status,
            z=z,
            lawful=-pressure[:, None] * normals + friction.lawful,
            closed=closed,
        )

    def _nearest_friction(
        self, slip: np.ndarray, friction: np.ndarray, limit: np.ndarray, free: np.ndarray
    ) -> _NearestFriction:
        """Return the lawful friction nearest to that of contact nodes: ``slip``, m, and ``friction``, N,
        (n_contact, dim), the bound ``limit`` (n_contact,), N, and projections ``free`` (n_contact, dim,
        dim) onto what supports leave free. A node loses its slip if moving it back costs less, in the
        measure of its stiffness, than changing its friction to the bound, against the slip."""
        d = self.stiffness
        size = np.linalg.norm(slip, axis=1)
        direction = -_directions(slip)
        excess = np.maximum(np.linalg.norm(friction, axis=1) - limit, 0.0)
        turned = limit[:, None] * np.einsum("nij,nj->ni", free, direction)
        # d |tau|^2 to move it back, |excess|^2 / d to reach the bound, |f_t - turned|^2 / d to turn
        without_slip = (limit > 0) & (
            d * size**2 + excess**2 / d <= np.sum((friction - turned) ** 2, axis=1) / d
        )
        # a node without slip whose friction exceeds the bound slides along its friction force
        starts_to_slide = without_slip & (excess > 0)
        direction[starts_to_slide] = _directions(friction)[starts_to_slide]
        sticks = without_slip & ~starts_to_slide
        free_direction = np.einsum("nij,nj->ni", free, direction)
        lawful = np.where(sticks[:, None], friction, limit[:, None] * free_direction)
        turns = ~without_slip & (size > 0)
        turning = np.divide(limit, size, out=np.zeros_like(size), where=turns)
        return _NearestFriction(
            without_slip=without_slip,
            slides=~sticks,
            direction=direction,
            lawful=lawful,
            turning=turning,
        )


@dataclass(frozen=True, eq=False)
class _NearestStatus:
    """The contact status that a displacement u is nearest to."""

    status: FrozenStatus
    z: np.ndarray  # (n_nodes, dim): the change that meets the status, m
    lawful: np.ndarray  # (n_contact, dim): the contact forces of the status at u, N
    closed: np.ndarray  # (n_contact,) bool: which nodes touch


@dataclass(frozen=True, eq=False)
class _NearestFriction:
    """The lawful friction that is nearest to a claimed one."""

    without_slip: np.ndarray  # (n_contact,) bool: the slip is taken back to zero, by z
    #: (n_contact,) bool: K leaves tangents free: open nodes, those that slip, and those without slip that start to
    slides: np.ndarray
    direction: np.ndarray  # (n_contact, dim): unit vectors f of the friction of nodes that slide
    #: (n_contact, dim), N: the claimed friction of nodes that stick, the bound B along f of nodes that slide
    lawful: np.ndarray
    #: (n_contact,): B/|tau| of nodes that slip, N/m: friction turns with the slip tau; else 0
    turning: np.ndarray


def any_component(vectors: np.ndarray) -> np.ndarray:
    """Return where vectors (n, dim) are not zero: 5 us for 4225, by any(axis=1) 60."""
    return np.logical_or.reduce(list(vectors.T))


@remembered_of_structure
def _held_elsewhere(problem: DiscreteProblem) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (m,) off the contact boundaries that supports or ties hold, and projections
    (m, dim, dim) onto their free directions."""
    held = mask_of(problem.fixed_nodes(), problem.n_nodes)
    held[problem.contact.nodes] = False
    nodes = np.flatnonzero(held)
    return nodes, problem.free_spans(nodes)


def _image(rows: BlockRows, change: np.ndarray) -> np.ndarray:
    """Return A v (n_nodes, dim) of a symmetric matrix and a vector that is zero except at few nodes: in
    a tenth of the time of a product for the 257 contact nodes of 66k."""
    nodes = np.flatnonzero(any_component(change))
    places, columns, of_nodes = rows.entries(nodes)
    blocks = rows.data.reshape(-1, rows.dim, rows.dim)[places]
    images = np.zeros(change.shape)  # untouched memory is not taken
    # by symmetry the rows are columns
    np.add.at(images, columns, np.einsum("pij,pi->pj", blocks, change[nodes][of_nodes]))
    return images


def _directions(vectors: np.ndarray) -> np.ndarray:
    """Return unit vectors (n, dim), zero for vectors of length zero."""
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)


def _along(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the normal components (n,)."""
    return np.einsum("nd,nd->n", vectors, normals)


def ratio(value: float, scale: float) -> float:
    """Return a value over a scale: 0 for a zero value; over a zero scale 1 for another finite value, and
    infinite or NaN values unchanged."""
    if value == 0.0:
        return 0.0
    if scale == 0.0:
        return 1.0 if np.isfinite(value) else float(value)
    return float(value / scale)


def _norm(vector: np.ndarray) -> float:
    return float(np.sqrt(_sum(vector, vector)))


def _sum(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("i,i->", a.reshape(-1), b.reshape(-1)))
