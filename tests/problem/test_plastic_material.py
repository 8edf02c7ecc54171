"""The return mapping of plastic materials: closed forms, differences, turned axes."""

import numpy as np
import pytest

import adaptmg as am

ELASTIC = {
    4: am.PlaneStrain(young=2.1e11, poisson=0.3),
    6: am.Solid(young=2.1e11, poisson=0.3),
}
G = 2.1e11 / 2.6
SIZE = 3e8
TABLE = ((0.0, SIZE), (1e-3, 4e8), (4e-3, 4.5e8))
#: positions of the components of a tensor in the columns of a stress
PAIRS = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]).T


def columns(tensors: np.ndarray, often: float) -> np.ndarray:
    return tensors[:, *PAIRS] * np.where(PAIRS[0] == PAIRS[1], 1.0, often)


def sheared(material: am.Plastic, angles: list[float]) -> list[float]:
    """The shear stresses of a history of shear angles in the plane."""
    state = np.zeros((1, 5))
    stresses = []
    for angle in angles:
        stress, _, state = material.response(np.array([[0.0, 0.0, 0.0, angle]]), state)
        stresses.append(float(stress[0, 3]))
        np.testing.assert_allclose(stress[0, :3], 0.0, atol=1e-3)
    return stresses


@pytest.mark.parametrize("isotropic", [0.0, 5e9])
@pytest.mark.parametrize("kinematic", [0.0, 8e9])
def test_shear_to_and_fro_has_a_closed_form(isotropic, kinematic):
    """In shear tau = k + G_t (angle - k / G); back, yield begins 2 k lower with kinematic
    hardening, and at the opposite stress with isotropic hardening."""
    material = am.Plastic(ELASTIC[4], yield_stress=SIZE, hardening=isotropic, kinematic=kinematic)
    k = SIZE / np.sqrt(3)
    total = isotropic + kinematic
    slope = G * total / (3 * G + total)
    forth = 4 * k / G
    angles = [0.5 * k / G, 0.5 * forth, forth]
    top = k + slope * (forth - k / G)
    expected = [0.5 * k, k + slope * (0.5 * forth - k / G), top]
    # the radius of the yield surface has grown by the isotropic share
    size = k + (top - k) * (isotropic / total if total else 0.0)
    back = forth - 2 * size / G
    expected += [top - 2 * size, top - 2 * size - slope * k / G]
    angles += [back, back - k / G]
    np.testing.assert_allclose(sheared(material, angles), expected, rtol=1e-9)


def test_a_table_is_followed_across_its_rows_in_one_step():
    material = am.Plastic(ELASTIC[4], yield_stress=SIZE, hardening=TABLE)
    for accumulated, stress in ((5e-4, 3.5e8), (2.5e-3, 4.25e8), (1e-2, 4.5e8)):
        angle = np.sqrt(3) * accumulated + stress / np.sqrt(3) / G
        assert sheared(material, [angle])[0] == pytest.approx(stress / np.sqrt(3), rel=1e-12)
        halves = sheared(material, [0.5 * angle, angle])
        assert halves[-1] == pytest.approx(stress / np.sqrt(3), rel=1e-12)


@pytest.fixture(params=[4, 6], ids=["plane", "solid"])
def history(request):
    """Material, states after random strains, and further strains, of which some unload."""
    k = request.param
    material = am.Plastic(ELASTIC[k], yield_stress=SIZE, hardening=TABLE, kinematic=6e9)
    draw = np.random.default_rng(k)
    first = 4e-3 * draw.standard_normal((200, k))
    _, _, state = material.response(first, np.zeros((200, k + 1)))
    return material, state, first + 3e-3 * draw.standard_normal((200, k))


def test_the_tangent_is_the_derivative_of_the_stress(history):
    material, state, strain = history
    _, tangent, after = material.response(strain, state)
    assert 0.3 < np.mean(after[:, -1] > state[:, -1]) < 1
    step = 1e-9
    for c, move in enumerate(step * np.eye(strain.shape[1])):
        above, below = (material.response(strain + s * move, state)[0] for s in (1, -1))
        found = (above - below) / (2 * step)
        close = np.abs(found - tangent[:, :, c]).max(axis=1) < 1e-5 * 2.1e11
        assert close.mean() > 0.97  # a difference may lie across a corner of the table


def test_plastic_flow_follows_the_deviator_and_keeps_the_volume(history):
    material, state, strain = history
    stress, _, after = material.response(strain, state)
    k = strain.shape[1]
    np.testing.assert_allclose(after[:, :3].sum(axis=1), 0.0, atol=1e-15)
    s = stress - np.where(np.arange(k) < 3, stress[:, :3].mean(axis=1)[:, None], 0.0)
    half = np.where(np.arange(k) < 3, 1.0, 0.5)
    xi = s - 2 / 3 * 6e9 * half * after[:, :k]
    size = np.sqrt(1.5 * (xi**2 / half) @ np.ones(k))
    limit = np.interp(after[:, k], *np.transpose(TABLE))
    yields = after[:, k] > state[:, k]
    np.testing.assert_allclose(size[yields], limit[yields], rtol=1e-10)
    assert (size <= limit * (1 + 1e-10)).all()
    flow = ((after - state)[:, :k] * half)[yields]
    cosine = (flow * xi[yields] / half).sum(axis=1)
    norms = [np.sqrt((x**2 / half).sum(axis=1)) for x in (flow, xi[yields])]
    np.testing.assert_allclose(cosine, norms[0] * norms[1], rtol=1e-9)


def test_the_response_turns_with_the_strain():
    material = am.Plastic(ELASTIC[6], yield_stress=SIZE, hardening=1e9, kinematic=4e9)
    draw = np.random.default_rng(7)
    turn = np.linalg.qr(draw.standard_normal((3, 3)))[0]
    tensors = 4e-3 * draw.standard_normal((2, 50, 3, 3))
    tensors += tensors.swapaxes(2, 3)
    stresses = []
    for q in (np.eye(3), turn):
        state = np.zeros((50, 7))
        for strain in tensors:
            stress, _, state = material.response(columns(q @ strain @ q.T, 2.0), state)
        full = np.empty((50, 3, 3))
        full[:, *PAIRS] = full[:, *PAIRS[::-1]] = stress
        stresses.append(q.T @ full @ q)
    np.testing.assert_allclose(stresses[1], stresses[0], atol=1e-10 * np.abs(stresses[0]).max())


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"yield_stress": 0.0}, "yield_stress must be"),
        ({"hardening": -1.0}, "hardening must be"),
        ({"hardening": ((0.0, SIZE), (1e-3, 0.5 * SIZE))}, "do not fall"),
        ({"hardening": ((0.0, 2 * SIZE), (1e-3, 3 * SIZE))}, "must begin with the yield stress"),
        ({"kinematic": np.nan}, "kinematic must be"),
        ({"elastic": am.PlaneStress(young=1e11, poisson=0.3)}, "elastic must be an isotropic"),
        ({"elastic": am.PlaneStrain(young=1e11, poisson=0.5)}, "poisson below 0.5"),
    ],
)
def test_what_a_plastic_material_refuses(changed, words):
    values = {"elastic": ELASTIC[4], "yield_stress": SIZE} | changed
    with pytest.raises(ValueError, match=words):
        am.Plastic(**values)
