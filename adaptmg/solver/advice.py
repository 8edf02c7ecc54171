"""Advice: warnings on what a problem or its solution asks of the theory and cannot get, each with a
remedy.

Limits of the theory: linear elements, small strains, rotations and slips, lengths in m. Thresholds are such
that none of the cases of the package is beyond one. A kind of warning is given once a call of
:func:`adaptmg.solve`,
:func:`adaptmg.solve_path` or :func:`adaptmg.adapt`, at the line of the user.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import warn_user
from adaptmg.discrete.elasticity import element_measures
from adaptmg.discrete.loads import check_loads
from adaptmg.discrete.moduli import inelastic_bodies
from adaptmg.discrete.mortar import chord_heights
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.sides import STIFFER, exchangeable
from adaptmg.discrete.stress import LOCKING, element_strain, hoop_strain
from adaptmg.mesh.arrays import MeshArrays, Surface, mask_of
from adaptmg.problem import Contact, ContactPair, InitialStrain, Plane, PlaneStress
from adaptmg.problem.laws import follows_state
from adaptmg.problem.surfaces import moving_parts
from adaptmg.smoother.system import OPEN, SLIP, contact_blocks, friction_bound
from adaptmg.solver.examine import ContactResult
from adaptmg.solver.result import Result

#: what locking means, measured: a roller (plane strain, frictionless, squeezed between planes) on adapted meshes of
#: 3500 nodes; at .3 they are .1 and 1.5 %
_LOCKED = "a force 0.1, 0.3, 1 % and a largest pressure 4, 11, 90 % too large at 0.45, 0.49, 0.499"
#: strains that are no longer small, where a share of a body's volume exceeds them (next to singular points they have
#: no bound): of 13 solves, two of which warn, half and twice of the first change one each, of the second none
STRAIN, SHARE = 0.05, 0.01
#: angle, rad, by which a body turns that lengthens it by that strain where rotations count as small: theta^2/2
ROTATION = np.sqrt(2 * STRAIN)
#: spans beyond this many m are doubted for bodies of metal, or of moduli of metals and plastics in N/mm^2, Pa: of 13
#: solves only twice the span changes one, a bar of 12 m
SPAN, METAL, IN_MPA = 10.0, 5e10, (1e3, 1e6)
#: bodies do not meet if the gap that is left exceeds all displacements by this factor: half and twice change none of 13
#: solves
FAR = 10.0
#: chords matter above this part of the gap, and where what they press is above this part of the peak: .4 E'h/l, of the
#: moduli E' of both bodies in series and chords of height h and length l. Measured on a pin in a hole with 64 to 524
#: edges on its rim: excess of the peak .3 to .5 E'h/l with the finer side as slave (.05 to .1 with the coarser one),
#: on Hertz's cylinder .17 with 5 to 20 edges in half of the contact
CHORDS, PRESSED, EXCESS = 0.2, 0.4, 0.1
#: nodes that face one node alone match: chords of both sides cancel; half and twice change none of 13 solves
PARTNER = 0.9
#: where edges turn by more there is a corner, and no arc of 8 edges or more a circle
CORNER = 0.4
#: where they turn by less the surface is plane, in coordinates of five digits; half and twice change none of 13 solves
FLAT = 1e-4
#: a friction bound falls with the pressure if its derivative is below minus this: less is rounding of differences
FALLING = checks.SIX_DIGITS
#: shares of a slip at which it is examined whether friction falls faster than the body follows
SLIP_SHARES = np.append(0, np.logspace(-3, 0, 7)).tolist()
#: slips matter beyond an element and this share of the contact boundary; half and twice change none of 13 solves
SLID = 0.01

_WARNED: ContextVar[set[str] | None] = ContextVar("warned", default=None)


@contextmanager
def once(kinds: set[str] | None = None) -> Iterator[None]:
    """Give each kind of warning once in this block; ``kinds`` collects the kinds, an outer block has
    precedence."""
    if _WARNED.get() is not None:
        yield
        return
    token = _WARNED.set(set() if kinds is None else kinds)
    try:
        yield
    finally:
        _WARNED.reset(token)


def advise(kind: str, text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that called the package, inside :func:`once` once of a kind."""
    kinds = _WARNED.get()
    if kinds is not None:
        if kind in kinds:
            return
        kinds.add(kind)
    warn_user(text, category)


def advise_on_problem(posed: Posed | None) -> None:
    """Warn of slaves on the wrong side, of elements that lock, and of lengths that are not in m;
    ValueError for loads that the mesh does not see."""
    if posed is None:
        return
    problem = posed.problem
    mesh = posed.mesh
    materials = posed.materials
    check_loads(mesh, problem.loads)
    # both sides of a pair within the only body are as stiff
    for pair in problem.contact if len(mesh.bodies) > 1 else ():
        if not isinstance(pair, ContactPair):
            continue
        ratio = posed.young(pair.slave) / posed.young(pair.master)
        if ratio >= STIFFER:
            remedy = 'exchange them, or give the pair sides="auto"'
            if not exchangeable(problem, pair):
                remedy = (
                    f"they cannot be exchanged while another pair, a tie or a support has {pair.master!r}: cut "
                    "that boundary in two, as am.Outline(boundaries=...) or am.Fuse(..., rename=...) can"
                )
            advise(
                "sides",
                f"contact pair ({pair.slave!r}, {pair.master!r}): the slave is {ratio:.3g} times stiffer "
                "than the master, which takes multigrid two to five times as many cycles as with "
                f"{pair.master!r} for the slave, or ends in the active set method: {remedy}",
            )
    for name, elastic in zip(mesh.bodies, materials, strict=True):
        if (
            problem.elements == "linear"
            and elastic.poisson > LOCKING
            and not isinstance(elastic, PlaneStress)
        ):
            advise(
                "poisson",
                f"material of body {name!r}: poisson is {elastic.poisson:g}: give the problem "
                f'elements="smoothed", since above {LOCKING:g} linear ones lock: they are too stiff, stresses '
                "oscillate, and with friction solvers may not converge. A rubber roller on 3500 nodes has "
                f"{_LOCKED}",
            )
    span = max(float(np.ptp(x)) for x in mesh.points.T)
    young = max(elastic.young for elastic in materials)
    if span > SPAN and (young >= METAL or IN_MPA[0] <= young <= IN_MPA[1]):
        advise(
            "units",
            f"the bodies span {span:g} m, with young up to {young:g} Pa: are these lengths in mm"
            f"{'' if young >= METAL else ' and moduli in N/mm^2'}? adaptmg takes m, N and Pa",
        )


def _advise_on_chords(
    posed: Posed | None, discrete: DiscreteProblem, results: Sequence[Result]
) -> None:
    """Warn of pairs with curved surfaces that are known only by chords, if these are nearly as high as
    the gap, or add considerably to the largest pressure."""
    if posed is None or discrete.coupling is None:
        return
    # (n_contact,): the largest pressure of each node in all results, Pa
    peaks = np.max([result.contact.pressure for result in results], axis=0, initial=0.0)
    contact = discrete.contact
    for k, pair in enumerate(posed.problem.contact):
        pressed = (contact.boundary == k) & (peaks > 0)
        # a gap that is given does not come from the chords
        if not isinstance(pair, ContactPair) or pair.gap is not None or not pressed.any():
            continue
        nodes = contact.nodes[pressed]
        facing = discrete.coupling.weights[nodes]
        if np.median(facing.max(axis=1).toarray()) > PARTNER:
            continue
        near_pressed = mask_of(np.append(nodes, facing.indices), discrete.n_nodes)
        chord = _highest_chord(posed.sides[k], near_pressed)
        if chord is None:
            continue
        height, length = chord
        mean_gap = np.average(np.abs(contact.gaps[pressed]), weights=contact.weights[pressed])
        modulus_in_series = 1 / (1 / posed.young(pair.slave) + 1 / posed.young(pair.master))
        # p = .4 E' h / l, and its ratio to the least pressure that is reported
        pressure_by_chords = PRESSED * modulus_in_series * height / length
        excess = pressure_by_chords / (EXCESS * peaks[pressed].max())
        if height > CHORDS * mean_gap or excess > 1:
            # an arc has heights like l^2, and so pressures like l
            size_needed = length * min(np.sqrt(CHORDS * mean_gap / height), 1 / excess)
            advise(
                "chords",
                f"contact pair ({pair.slave!r}, {pair.master!r}): the surfaces are curved, and known only by "
                f"chords that lie up to {height:.3g} m behind them; the gap is {mean_gap:.3g} m. Where nodes "
                "do not match, chords press like gaps, and peaks of pressure are too large. Give the problem "
                f"its domain, which knows its arcs, or take elements of at most {size_needed:.2g} m along both sides",
            )


def _highest_chord(
    sides: Sequence[Surface], near_pressed: np.ndarray
) -> tuple[float, float] | None:
    """Return the height h and the length l, m, of the highest chord of an arc on two surfaces, from
    facets with all their nodes in the mask ``near_pressed`` (n_nodes,); None without an arc. By its
    height l^2 / (8 r) a chord spans the angle l / r = 8 h / l of an arc of radius r."""
    heights, lengths = np.concatenate(
        [chord_heights(side)[:, near_pressed[side.facets].all(axis=1)] for side in sides], axis=1
    )
    # 4 h / l is the angle between the chord and the tangents at its ends
    is_arc = (FLAT * lengths < 4 * heights) & (4 * heights < CORNER * lengths)
    if not is_arc.any():
        return None
    highest = int(np.argmax(heights * is_arc))
    return heights[highest], lengths[highest]


def critical_coefficients(stiffness: np.ndarray) -> np.ndarray:
    """Return the critical coefficients of friction (n,) of nodes with these stiffnesses K (n, dim,
    dim) in their frames: the least eigenvalue of K_tt over |K_nt|. Below it the contact problem
    of a node alone has one solution."""
    tangential = stiffness[:, 1:, 1:].copy()
    # contact_blocks turns the sign of this entry where a support holds the first tangent alone; other
    # held tangents have no mark
    tangential[:, 0, 0] = np.abs(tangential[:, 0, 0])
    least = np.linalg.eigvalsh(tangential)[:, 0]
    coupling = np.linalg.norm(stiffness[:, 0, 1:], axis=1)
    is_coupled = coupling > 1e-12 * least  # less is rounding: any friction leaves one solution
    return np.divide(least, coupling, out=np.full(len(least), np.inf), where=is_coupled)


def warn_where_steep(rise: np.ndarray, critical: np.ndarray, what: str) -> None:
    """Warn where friction rises with the pressure by more than what leaves one solution; ``what`` names
    the rise (n_contact,), for which there are critical values (n_contact,)."""
    exceeds = rise >= critical
    if exceeds.any():
        i = int(np.argmax(np.where(exceeds, rise - critical, -np.inf)))
        advise(
            "friction",
            f"{what} {rise[i]:.3g} exceeds {critical[i]:.2g}, from which on a node in contact alone "
            f"may open, slip or stick under the same load ({np.count_nonzero(exceeds)} contact nodes): the solution "
            "may not be unique; compare am.solve(..., start=...) from several starts",
            RuntimeWarning,
        )


def advise_on_law(discrete: DiscreteProblem, contact: ContactResult) -> None:
    """Warn of friction that may have several solutions: where the bound mu p falls with the pressure,
    rises with it by more than the critical coefficient, or falls with the slip faster than the
    force of the body rises, -d(mu p)/ds > K_tt, at a slip s on the way to the present one."""
    if not follows_state(discrete.law):
        return
    force = contact.force_n
    # results have means over the nodes whose part a contact node takes over, friction_at takes sums
    slip = np.linalg.norm(contact.slip, axis=1) * contact.measures / contact.weights
    _, slope_of_pressure, _ = friction_bound(discrete.friction_at, force, slip)
    falling = contact.closed & (slope_of_pressure < -FALLING)
    if falling.any():
        i = int(np.argmin(np.where(falling, slope_of_pressure, 0.0)))
        advise(
            "falling",
            f"friction times pressure falls with the pressure at {np.count_nonzero(falling)} contact nodes "
            f"(at {contact.pressure[i]:.3g} Pa): the solution may not be unique, and methods may not "
            "converge; let the coefficient fall more slowly than 1 / pressure",
            RuntimeWarning,
        )
    blocks = contact_blocks(discrete)
    # a coefficient alone says little: where it falls like 1 / pressure the friction is constant
    warn_where_steep(
        np.where(contact.closed, slope_of_pressure, 0.0),
        critical_coefficients(blocks),
        "a slope of friction over pressure of",
    )
    # a node that has jumped is beyond the slips where friction falls fastest, and shows nothing
    # the last one of what friction_bound returns is the derivative by the slip
    slopes_of_slip = [
        friction_bound(discrete.friction_at, force, share * slip)[2] for share in SLIP_SHARES
    ]
    steepest = np.min(slopes_of_slip, axis=0)
    stiffness = np.abs(np.diagonal(blocks[:, 1:, 1:], axis1=1, axis2=2)).max(axis=1)
    weak = (contact.state == SLIP) & (-steepest > stiffness)
    if weak.any():
        i = int(np.argmax(np.where(weak, -steepest / stiffness, 0.0)))
        advise(
            "weakening",
            f"friction falls with the slip {-steepest[i] / stiffness[i]:.2g} times faster than the body "
            f"follows at {np.count_nonzero(weak)} contact nodes: they may jump, and the solution may not be "
            "unique; let friction fall over a longer slip",
            RuntimeWarning,
        )


def advise_on_adhesion(discrete: DiscreteProblem, contact: ContactResult) -> None:
    """Warn of boundaries whose open nodes, with Tresca's law, carry more friction than those in
    contact."""
    limit, _ = discrete.law.bounds(len(contact.node))
    friction = np.where(limit > 0, np.linalg.norm(contact.force_t, axis=1), 0.0)
    by_open = np.bincount(contact.boundary, friction * ~contact.closed, len(contact.names))
    by_closed = np.bincount(contact.boundary, friction * contact.closed, len(contact.names))
    if (by_open > by_closed).any():
        k = int(np.argmax(by_open - by_closed))
        advise(
            "adhesion",
            f"contact {contact.names[k]!r}: its open nodes carry {by_open[k]:.3g} {contact.units[0]} of friction, "
            f"those in contact {by_closed[k]:.3g}: Tresca's limit holds without contact, too. Give "
            "am.Tresca a function of position that is 0 outside the contact, or take am.StateLaw or am.Coulomb",
        )


def advise_on_results(
    posed: Posed | None, discrete: DiscreteProblem, results: Sequence[Result]
) -> None:
    """Warn of bodies that cannot meet in any of these steps, of large strains and of large slips, and
    of chords that press."""
    converged = [result for result in results if result.status.ok]
    if converged:
        _advise_on_contact(converged)
    if converged and posed is not None:
        advise_on_motion(posed, converged)
    _advise_on_chords(posed, discrete, results)


def advise_on_motion(posed: Posed, results: Sequence[Result]) -> None:
    """Warn of large strains, rotations and slips in results on one mesh."""
    body_volumes = _body_volumes(posed)
    # where strains are large, their warning is enough
    strained = [_advise_on_strains(posed, result, body_volumes) for result in results]
    _advise_on_rotations(
        posed.mesh,
        [result for result, large in zip(results, strained, strict=True) if not large],
    )
    _advise_on_slips(posed, results)


def _advise_on_contact(results: Sequence[Result]) -> None:
    """Warn of contact boundaries without a condition, and of bodies that stay far apart in all
    results."""
    contact = results[0].contact
    if results[0].dim == 1:  # a membrane may well stay off its obstacle
        return
    # einsum: 1.2 ms for 263k nodes, by norm(axis=1) 7.2
    largest_motion = max(
        float(np.sqrt(np.einsum("nd,nd->n", u, u).max(initial=0.0)))
        for u in (result.displacement for result in results)
    )
    for k, name in enumerate(contact.names):
        on_boundary = contact.boundary == k
        if not on_boundary.any():
            advise(
                "silent",
                f"contact {name!r} has no condition: all its nodes belong to supports, ties or contact "
                "boundaries named before it, and bodies may pass there. Make the mesh finer, or name "
                "it first",
            )
            continue
        least_gap = min(
            float(result.contact.gap[on_boundary].min(initial=np.inf)) for result in results
        )
        if largest_motion > 0.0 and least_gap > FAR * largest_motion:
            master = contact.masters[k]
            advise(
                "apart",
                f"contact {name!r} stays at least {least_gap:.3g} m from "
                f"{repr(master) if master else 'its obstacle'}, and no point moves "
                f"by more than {largest_motion:.3g} m: they cannot meet. Check the positions and normals of both "
                "(m), and the loads that press them together",
            )


def _advise_on_strains(posed: Posed, result: Result, body_volumes: np.ndarray) -> bool:
    """Return whether strains are large in a considerable share of the volume of a body
    (``body_volumes`` (n_bodies,), m^2 or m^3), and warn if they are."""
    problem = posed.problem
    mesh = posed.mesh
    if _energy_excludes_strains(posed, result, body_volumes):
        return False
    volumes = element_measures(mesh, problem.axisymmetric)
    # the largest principal strain, stretch or compression
    strain_sizes = np.linalg.norm(element_strain(mesh, result.displacement), ord=2, axis=(1, 2))
    if problem.axisymmetric:
        strain_sizes = np.maximum(strain_sizes, np.abs(hoop_strain(mesh, result.displacement)))
    large_share = (
        np.bincount(mesh.element_body, volumes * (strain_sizes > STRAIN), len(body_volumes))
        / body_volumes
    )
    body = int(np.argmax(large_share))
    if large_share[body] > SHARE:
        largest = strain_sizes[mesh.element_body == body].max()
        advise(
            "strain",
            f"strains exceed {100 * STRAIN:g} % in {100 * large_share[body]:.3g} % of body "
            f"{mesh.bodies[body]!r} (largest {largest:.3g}), but the theory is one of small strains: check young "
            f"({posed.materials[body].young:g} Pa; steel has 2.1e11) and the loads (Pa, N), or load it less",
        )
    return bool(large_share[body] > SHARE)


def _body_volumes(posed: Posed) -> np.ndarray:
    """Return the volumes (n_bodies,) of the bodies, m^2 or m^3, in axisymmetry of the full
    circumference. That of a single body is sum_f x_f . n_f / dim over its facets, with their middles x
    and area vectors n: of 263k plane nodes .2 ms, over all elements 2.1."""
    mesh = posed.mesh
    axisymmetric = posed.problem.axisymmetric
    if len(mesh.bodies) > 1 or axisymmetric:
        return np.bincount(
            mesh.element_body, element_measures(mesh, axisymmetric), len(mesh.bodies)
        )
    middles = mesh.points[mesh.facets].mean(axis=1)
    flux = np.einsum("fd,fd->", middles, Surface(mesh.points, mesh.facets).vectors)
    return np.array([flux / mesh.dim])


def _energy_excludes_strains(posed: Posed, result: Result, body_volumes: np.ndarray) -> bool:
    """Return whether u'Au is below the energy of strains STRAIN in the share SHARE of any body: at
    least C STRAIN^2 SHARE V, C its least stiffness and V its volume (``body_volumes`` (n_bodies,), m^2 or m^3).
    This spares most solves the strains. Bodies that yield, or that strain without stress, may have
    less energy."""
    if (
        result.checked is None
        or inelastic_bodies(posed.materials).any()
        or any(isinstance(load, InitialStrain) for load in posed.problem.loads)
    ):
        return False
    least_energy = (
        STRAIN**2
        * SHARE
        * min(
            elastic.least_stiffness * volume
            for elastic, volume in zip(posed.materials, body_volumes, strict=True)
        )
    )
    return result.checked.energy_norm**2 < least_energy


def _advise_on_rotations(mesh: MeshArrays, results: Sequence[Result]) -> None:
    """Warn of bodies that turn far."""
    # no rotations of scalar problems
    motions = [result.displacement for result in results if result.dim == mesh.dim]
    for body, name in enumerate(mesh.bodies if motions else ()):
        elements = np.flatnonzero(mesh.element_body == body)
        # a rotation shows on a thousand elements; all of 131 000 take a sixth of the whole solve
        sample = mesh.elements[elements[:: len(elements) // 1000 + 1]]
        nodes = np.flatnonzero(mask_of(sample, mesh.n_nodes))  # sorted
        place = mesh.points[nodes] - mesh.points[nodes].mean(axis=0)
        # the gradients of the linear motions next to those of the nodes; translations are orthogonal to
        # the places, which count from their middle
        moved = np.hstack([motion[nodes] for motion in motions])
        gradients = np.linalg.lstsq(place, moved, rcond=None)[0]
        for gradient in np.hsplit(gradients, len(motions)):
            # the skew part has entries theta, so that |G - G'| = 2 sqrt(2) theta
            angle = np.linalg.norm(gradient - gradient.T) / np.sqrt(8)
            if not angle > ROTATION:
                continue
            advise(
                "rotation",
                f"body {name!r} turns by {np.degrees(angle):.3g} degrees, but the theory is one of small rotations, "
                f"which lengthens it by {angle**2 / 2:.2g}: support it, or load it in a way that rolls it less",
            )


def _advise_on_slips(posed: Posed, results: Sequence[Result]) -> None:
    """Warn of slips beyond an element and beyond a share of the contact boundary."""
    mesh = posed.mesh
    for k, contact_part in enumerate(posed.problem.contact):
        if isinstance(contact_part, Contact):
            # the shape that the innermost of the motions moves
            shape = contact_part.obstacle
            for moving in moving_parts(shape):
                shape = moving.obstacle
            if isinstance(shape, Plane):
                continue  # it is the same everywhere, also after a motion
        facets = posed.surfaces[contact_part.boundary].facets
        corners = mesh.points[facets]
        element_size = np.zeros(mesh.n_nodes)
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        np.maximum.at(element_size, facets, edges[:, None])
        boundary_extent = np.linalg.norm(np.ptp(corners.reshape(-1, mesh.dim), axis=0))
        for contact in (result.contact for result in results):
            touching = np.flatnonzero((contact.boundary == k) & (contact.state != OPEN))
            slip = np.linalg.norm(contact.u_t[touching], axis=1)
            most_slip = np.maximum(element_size[contact.node[touching]], SLID * boundary_extent)
            if not (slip > most_slip).any():
                continue
            i = int(np.argmax(slip - most_slip))
            advise(
                "slip",
                f"contact {contact_part.boundary!r} slips by {slip[i]:.3g} m, more than {most_slip[i]:.3g} m, the "
                f"larger of an element and {SLID:.0%} of the boundary, but the theory is one of small slips: each "
                "point stays opposite to where it was. Move or load the bodies less, or pose the problem in the "
                "position to which they slid",
            )
