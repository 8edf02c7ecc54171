"""Condensation to the contact dofs: against dense algebra, on one body and on several."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from smoother_problems import network

import adaptmg as am
from adaptmg.discrete.problem import ContactNodes, DiscreteProblem
from adaptmg.mesh.structured import structured
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver import factorisation
from adaptmg.solver.factorisation import condense


def contact_dofs(local: LocalProblem) -> np.ndarray:
    dim = local.system.dim
    return (dim * local.system.nodes[:, None] + np.arange(dim)).ravel()


def dense_condensation(local: LocalProblem) -> tuple[np.ndarray, np.ndarray]:
    matrix, c = local.system.matrix.toarray(), contact_dofs(local)
    i = np.setdiff1d(np.arange(len(matrix)), c)
    through = matrix[np.ix_(c, i)] @ np.linalg.inv(matrix[np.ix_(i, i)])
    return matrix[np.ix_(c, c)] - through @ matrix[np.ix_(i, c)], local.load[c] - through @ local.load[i]


def bar(divisions: int = 6, problem: am.ContactProblem = am.cases.greco_bar()) -> LocalProblem:  # noqa: B008
    return local_system(am.discretise(problem, structured(problem.domain, divisions)))


def together(*problems: DiscreteProblem) -> DiscreteProblem:
    """Several bodies, contact nodes of the bodies in turns."""
    shifts = np.cumsum([0, *(p.n_nodes for p in problems)])[:-1]
    order = np.argsort(np.concatenate([np.arange(len(p.contact)) for p in problems]), kind="stable")

    def joined(*arrays: np.ndarray) -> np.ndarray:
        return np.concatenate(arrays)[order]

    contacts = [p.contact for p in problems]
    contact = ContactNodes(nodes=joined(*(c.nodes + shift for c, shift in zip(contacts, shifts, strict=True))),
                           normals=joined(*(c.normals for c in contacts)), gaps=joined(*(c.gaps for c in contacts)))
    return DiscreteProblem(
        matrix=sparse.block_diag([p.matrix for p in problems], format="csr"), law=am.Coulomb(1.0), contact=contact,
        load=np.concatenate([p.load for p in problems]), fixed=np.concatenate([p.fixed for p in problems]))


PROBLEMS = {"bar": bar, "block": lambda: bar(3, am.cases.greco_block(plane_strain=False)),
            "network": lambda: network(3, "coulomb", fixed_tangent=True),
            "three bodies": lambda: local_system(together(*3 * [bar(3).discrete])),
            "no coordinates": lambda: local_system(replace(bar().discrete, coordinates=None))}


@pytest.mark.parametrize("dense", [0, 10**6])
@pytest.mark.parametrize("name", PROBLEMS)
def test_condensation_is_that_of_dense_algebra_and_its_recovery_in_equilibrium(name, dense, monkeypatch):
    monkeypatch.setattr(factorisation, "_DENSE", dense)
    local = PROBLEMS[name]()
    condensed, (schur, load) = condense(local), dense_condensation(local)
    for matrix in (condensed.matrix, condensed.problem.system.matrix.toarray()):
        assert np.abs(matrix - schur).max() < 1e-13 * np.abs(schur).max()
    assert np.abs(condensed.problem.load - load).max() < 1e-13 * np.abs(local.load).max() * len(load)
    assert not condensed.problem.load[condensed.problem.system.fixed].any()
    unknowns = np.random.default_rng(0).normal(size=len(load)) * 1e-5
    unknowns[condensed.problem.system.fixed] = 0.0
    full = condensed.recover(unknowns)
    rest, forces = local.load - local.system.matrix @ full, np.abs(local.system.matrix) @ np.abs(full)
    away = np.setdiff1d(np.arange(len(full)), contact_dofs(local))
    assert np.array_equal(condensed.restrict(full), unknowns)
    assert np.abs(rest[away]).max() < 1e-13 * forces.max()
    assert np.abs(condensed.restrict(rest) - condensed.problem.load
                  + condensed.matrix @ unknowns).max() < 1e-12 * forces.max()


@pytest.mark.parametrize("dense", [0, 10**6])
def test_a_body_without_support_and_contact_is_refused_or_left_out(dense, monkeypatch):
    monkeypatch.setattr(factorisation, "_DENSE", dense)
    held = bar(3).discrete
    both = together(held, replace(held, fixed=np.zeros(held.n_dofs, dtype=bool)))
    keep = both.contact.nodes < held.n_nodes
    loose = local_system(replace(both, contact=ContactNodes(
        nodes=both.contact.nodes[keep], normals=both.contact.normals[keep], gaps=both.contact.gaps[keep])))
    with pytest.raises(ValueError, match="singular even with all contact dofs fixed"):
        condense(loose)
    lenient = condense(loose, lenient=True)
    np.testing.assert_allclose(lenient.matrix, condense(bar(3)).matrix, atol=1e-13 * np.abs(lenient.matrix).max())
    assert len(lenient.factors.order) == both.n_dofs - 3
