"""Runs of a study that differ in law, load or material take over meshes and matrices, and change no bit by that."""

import threading
from dataclasses import replace

import numpy as np

import adaptmg as am
from adaptmg._reuse import _Recent, recent, taken_over
from adaptmg.study import Study

BAR, JOINT = am.cases.greco_bar, am.cases.dovetail
SCALE = [1.0]


def posed(which):
    """Problems that differ in one thing from the one before."""
    joint = JOINT()
    return {"bar": BAR(), "friction": BAR(law=am.Coulomb(0.2)), "frictionless": BAR(law=am.Frictionless()),
            "load": BAR(top_pressure=1e7), "material": BAR(young=1e11), "size": BAR(size=30e-3),
            "joint": joint, "joint's friction": replace(joint, law=am.Coulomb(0.7)),
            "joint's load": replace(joint, loads=joint.loads[:1])}[which]


def grids_of(problem):
    if problem.domain.dim == 2 and problem.name.startswith("dovetail"):
        return am.Hierarchy.graded(problem, (8e-3, 4e-3), contact_ratio=2)
    return am.Hierarchy.uniform(problem, (4, 8))


def run(which):
    from adaptmg._reuse import recent as here

    return {"solution": am.solve(grids_of(posed(which)), throw=False).displacement, "kept": len(here.kept)}


def test_runs_that_share_meshes_have_the_bits_of_runs_alone():
    names = ("bar", "friction", "joint", "frictionless", "joint's friction", "load", "joint's load", "material", "size")
    study = Study(run, {"which": list(names)})
    table = study.run(progress=False, throw=True)
    for k, name in enumerate(names):
        np.testing.assert_array_equal(study.load(k)["solution"], run(name)["solution"])
    assert table["kept"].tolist() == [1, 1, 2, 2, 2, 2, 2, 2, 3]
    assert not recent.kept


def test_a_run_that_changes_its_matrices_changes_no_later_run():
    def stiffer(friction, which):
        grids = grids_of(BAR(law=am.Coulomb(friction)))
        if which == "matrix":
            grids.finest.discrete.matrix.data *= 2.0
        else:
            grids.finest.prolongation.data[::2] *= 0.5
        return {"tip": float(am.solve(grids, am.Multigrid(), throw=False).displacement.max())}

    for which in ("matrix", "prolongation"):
        table = Study(stiffer, {"friction": [0.2, 0.4, 0.3]}, fixed={"which": which}).run(progress=False)
        assert table["tip"].tolist() == [stiffer(friction, which)["tip"] for friction in (0.2, 0.4, 0.3)]


def solved(push):
    return {"tip": float(am.solve(am.Hierarchy.uniform(push, (2, 4))).displacement.max())}


def test_a_function_that_reads_what_changes_is_asked_again():
    square = am.Rectangle(width=1.0, height=1.0)
    parts = {"domain": square, "material": am.PlaneStrain(young=1e9, poisson=0.3), "law": am.Frictionless()}
    loaded = am.ContactProblem(contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))), supports=(am.Symmetry("left"),),
                               loads=(am.Pressure("top", lambda x: SCALE[0] * np.ones(len(x))),), **parts)
    obstacle = am.GapFunction(lambda x: 1e-9 * SCALE[0] * np.ones(len(x)))
    gapped = am.ContactProblem(contact=am.Contact("bottom", obstacle), supports=(am.Symmetry("left"),),
                               loads=(am.Pressure("top", 1e4),), **parts)
    for problem in (loaded, gapped):
        found = []
        for SCALE[0] in (1.0, 3.0, 1.0):
            with taken_over():
                found.append(solved(problem)["tip"])
            assert found[-1] == solved(problem)["tip"]
        assert found[0] == found[2] != found[1]
    recent.kept.clear()


def test_only_earlier_runs_of_the_same_thread_are_taken_over():
    def mesh():
        return am.Hierarchy.uniform(BAR(), (2, 4)).finest.mesh

    with taken_over():
        again, first = mesh(), mesh()
        assert again is not first
    with taken_over():
        assert mesh() is first
        other = []
        thread = threading.Thread(target=lambda: other.append(mesh()))
        thread.start()
        thread.join()
        assert other[0] is not first
    assert mesh() is not first
    recent.kept.clear()


def test_few_objects_of_moderate_size_are_kept():
    kept = _Recent()
    kept.on = True
    for run, (key, size) in enumerate([(1, 1), (2, 1), (3, 1), (4, 1), (2, 1), (5, kept.SIZE - 1), (6, kept.SIZE + 1)]):
        kept.run = run
        kept.find((key,))
        kept.keep((key,), size, key)
        assert len(kept.kept) <= kept.MOST
    assert [one.made for one in kept.kept] == [2, 5]
    kept.keep((object(),), 1, 7)
    assert len(kept.kept) == 2
