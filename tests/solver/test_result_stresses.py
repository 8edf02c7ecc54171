"""A result knows its stresses: materials by body, initial strains, steps of load paths, files; a bare problem none."""

import dataclasses

import numpy as np
import pytest
from made import result_on, square
from made_bodies import two_bodies

import adaptmg as am
from adaptmg.discrete.stress import StressData, full_stress, von_mises

#: by name in the columns of ``stresses()``
COLUMNS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def squeezed(kind: type = am.PlaneStrain, strain: float = -2e-4) -> am.ContactProblem:
    """A warm plate between a support and a smooth plane."""
    plate = am.Rectangle(width=0.02, height=0.01, origin=(0.01, 0.0))
    return am.ContactProblem(
        material=kind(young=2e11, poisson=0.3), domain=plate, law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        supports=(am.Support("top", y=0), am.Support("left", x=0)),
        loads=(am.InitialStrain("body", (strain, strain, strain)), am.Pressure("right", 1e7)))


@pytest.mark.parametrize("kind", [am.PlaneStrain, am.PlaneStress, am.Axisymmetric])
def test_solved_results_and_steps_of_paths_have_the_stresses_of_their_problem(kind, tmp_path):
    problem = squeezed(kind)
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4))
    factors = (0.0, 0.5, 2.0)
    steps = am.solve_path(grids, am.LoadPath({"body": factors, "right": (1.0, 1.0, 0.5)}))
    steps.save(tmp_path / "path")
    loaded = am.PathResult.load(tmp_path / "path")
    for factor, result, again in ((1.0, am.solve(grids), None), *zip(factors, steps, loaded, strict=True)):
        loads = [am.InitialStrain("body", tuple(factor * c for c in problem.loads[0].components))]
        wanted = full_stress(result.mesh, problem.material, result.displacement, loads)
        assert np.abs(wanted[:, 0, 0]).max() > 1e6
        np.testing.assert_allclose(result.stresses(), wanted[:, *np.transpose(COLUMNS)], rtol=1e-9,
                                   atol=1e-9 * np.abs(wanted).max())
        np.testing.assert_allclose(result.von_mises(), von_mises(wanted), rtol=1e-9)
        if again is not None:
            np.testing.assert_array_equal(again.stresses(), result.stresses())
            assert again.stress_data.axisymmetric == (kind is am.Axisymmetric)


def test_a_result_without_materials_says_so():
    grids = am.Hierarchy.uniform(squeezed(), divisions=(4,))
    for result in (am.solve(grids.finest.discrete), result_on(square(2)), result_on(None)):
        assert result.stress_data is None
        for method in (result.stresses, result.von_mises):
            with pytest.raises(ValueError, match=r"no materials.*bare DiscreteProblem.*StressData\.of"):
                method()
    given = dataclasses.replace(result_on(square(2)), stress_data=StressData.of(square(2), squeezed().material))
    assert given.stresses().shape == (8, 6)
    with pytest.raises(ValueError, match="do not belong to a mesh of 1"):
        dataclasses.replace(given, stress_data=two_bodies().stress_data).stresses()


@pytest.mark.parametrize(("field", "values", "said"), [
    ("kind", np.array([3], dtype=np.int8), "points to 3"), ("lame", np.array([np.nan]), "finite"),
    ("initial_strain", np.zeros((4, 2)), "shape")])
def test_a_file_with_damaged_stress_data_is_refused(tmp_path, field, values, said):
    result = dataclasses.replace(result_on(square(2)), stress_data=StressData.of(square(2), squeezed().material))
    bad = dataclasses.replace(result.stress_data, **{field: values})
    dataclasses.replace(result, stress_data=bad).save(tmp_path / "r.npz")
    with pytest.raises(ValueError, match=f"r.npz.*damaged.*{said}"):
        am.Result.load(tmp_path / "r.npz")
