"""Contact surfaces that give way in proportion to the pressure."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EXACT, bar_hierarchy, bar_on_block, rotation, turned
from refused import refused
from scipy.sparse import bsr_array
from scipy.sparse.linalg import spsolve

import adaptmg as am
from adaptmg.solver.certificate import certify

SOFT = am.NormalCompliance(2e-13)
PRESSURE, YOUNG = 1e7, 2e11
METHODS = [am.FullMultigrid(rtol=1e-10), EXACT, am.SingleGrid(omega=1.7, rtol=1e-10)]
IDS = ("full", "active set", "single grid")


def column(dim, turn, shift, compliance, law=am.Frictionless(), push=0.0):
    """Meshes of a column pressed on a plane, turned and shifted, and its problem."""
    domain = (
        am.Rectangle(width=0.08, height=0.04)
        if dim == 2
        else am.Box(width=0.08, depth=0.04, height=0.04)
    )
    divisions = ((4, 2), (8, 4)) if dim == 2 else ((2, 1, 1), (4, 2, 2))
    meshes = [turned(am.mesh.structured(domain, n), turn) for n in divisions]
    meshes = [replace(mesh, points=mesh.points + np.array(shift)) for mesh in meshes]
    up = rotation(turn) @ np.eye(dim)[dim - 1]
    loads = [am.Pressure("top", PRESSURE)]
    return meshes, am.ContactProblem(
        material=(am.PlaneStrain if dim == 2 else am.Solid)(young=YOUNG, poisson=0.0),
        law=law,
        contact=am.Contact("bottom", am.Plane(tuple(shift), tuple(up)), compliance=compliance),
        loads=[*loads, am.Pressure("left", push)] if push else loads,
        supports=[am.Support(name, normal=0) for name in ("right", "back")[: dim - 1]],
    )


PLACES = ((2, 0.7, (0.2, -0.1)), (3, (0.3, -0.2, 0.4), (0.1, 0.2, 0.3)))


@pytest.mark.parametrize("method", METHODS, ids=IDS)
@pytest.mark.parametrize("place", PLACES, ids=("plane", "space"))
def test_column_sinks_by_its_shortening_and_the_layer(place, method):
    meshes, problem = column(*place, SOFT)
    result = am.solve(am.Hierarchy.from_meshes(problem, meshes), method)
    normals = result.contact.normal[0]
    top = result.displacement[meshes[-1].boundary_nodes("top")] @ normals
    np.testing.assert_allclose(top, 0.04 * PRESSURE / YOUNG + SOFT.compliance * PRESSURE, rtol=1e-7)
    np.testing.assert_allclose(result.contact.pressure, PRESSURE, rtol=1e-7)
    np.testing.assert_allclose(-result.contact.gap, SOFT.compliance * PRESSURE, rtol=1e-6)


def test_frictionless_bodies_stand_on_springs():
    meshes, problem = column(*PLACES[0], SOFT, push=3e7)
    problem = replace(problem, material=am.PlaneStrain(young=YOUNG, poisson=0.3))
    discrete = am.discretise(problem, meshes[-1])
    contact = discrete.contact
    springs = np.zeros((discrete.n_nodes, 2, 2))
    stiffness = contact.weights / SOFT.compliance
    springs[contact.nodes] = stiffness[:, None, None] * np.einsum(
        "ni,nj->nij", contact.normals, contact.normals
    )
    added = bsr_array((springs, np.arange(len(springs)), np.arange(len(springs) + 1)))
    matrix = discrete.matrix + added
    free = ~discrete.fixed
    expected = np.zeros(discrete.n_dofs)
    expected[free] = spsolve(matrix.tocsc()[free][:, free], discrete.load[free])
    result = am.solve(am.Hierarchy.from_meshes(problem, meshes), METHODS[0])
    assert result.contact.closed.all()
    np.testing.assert_allclose(
        result.displacement.reshape(-1), expected, atol=1e-8 * np.abs(expected).max()
    )


def soft(problem, compliance):
    return replace(
        problem, contact=tuple(replace(one, compliance=compliance) for one in problem.contact)
    )


@pytest.mark.parametrize("body", ["obstacle", "pair"])
def test_stiffer_layers_tend_to_rigid_surfaces_to_first_order(body):
    def solution(compliance, method=EXACT):
        law = am.Coulomb(0.4)
        if body == "pair":
            return am.solve(bar_hierarchy(soft(bar_on_block(law), compliance), 2), method)
        meshes, problem = column(*PLACES[0], compliance, law, 2e7)
        return am.solve(am.Hierarchy.from_meshes(problem, meshes), method)

    rigid = solution(None).displacement
    far = [
        np.linalg.norm(solution(am.NormalCompliance(c)).displacement - rigid)
        for c in (1e-16, 1e-17)
    ]
    assert far[0] == pytest.approx(10 * far[1], rel=0.05)
    layer = am.NormalCompliance(1e-13)
    exact = solution(layer)
    found = solution(layer, METHODS[0])
    size = np.abs(exact.displacement).max()
    np.testing.assert_allclose(found.displacement, exact.displacement, atol=1e-8 * size)
    assert found.cycles <= solution(None, METHODS[0]).cycles + 2
    assert not found.certificate().contradictions(1e-9)


def test_layers_go_with_friction_that_depends_on_pressure():
    law = am.StateLaw(lambda pressure, slip: 0.1 + 0.3 / (1 + pressure / 1e7))
    meshes, problem = column(*PLACES[0], SOFT, law, 2e7)
    contact = am.solve(am.Hierarchy.from_meshes(problem, meshes), METHODS[0]).contact
    np.testing.assert_allclose(-contact.gap, SOFT.compliance * contact.pressure, rtol=1e-6)
    np.testing.assert_allclose(
        contact.limit, law.friction(contact.pressure, 0.0) * contact.force_n, rtol=1e-6
    )


def test_certificate_refuses_the_solution_of_another_layer():
    meshes, problem = column(*PLACES[0], SOFT)
    softer = soft(problem, am.NormalCompliance(4e-13))
    other = am.solve(am.Hierarchy.from_meshes(softer, meshes), EXACT)
    checked = certify(am.discretise(problem, meshes[-1]), other.displacement, other.contact)
    assert "penetration" in checked.contradictions(1e-8)


def monotone():
    meshes, problem = column(*PLACES[0], SOFT)
    grids = am.Hierarchy.from_meshes(problem, meshes)
    return am.solve(grids, am.Multigrid(correction=am.Monotone()))


test_refused = refused(
    (lambda: am.NormalCompliance(-1e-13), "compliance must be"),
    (
        lambda: am.Contact("bottom", am.Plane((0, 0), (0, 1)), compliance=1e-13),
        TypeError,
        "NormalCompliance",
    ),
    (monotone, "correction=am.Truncated"),
)
