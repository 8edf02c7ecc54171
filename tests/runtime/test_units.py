"""Other units than SI: of tables, pictures and reports; arrays stay in SI units."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import adaptmg as am

RESULT = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
PSI, INCH, LBF = 6894.757, 25.4e-3, 4.448222  # Pa, m, N


@pytest.fixture
def chosen():
    yield am.set_units
    am.set_units("SI")


def test_tables_have_the_units_asked_for():
    plain = RESULT.contact.table()
    pressures = plain["pressure [Pa]"].to_numpy()
    for units, heads in (
        (
            "mm-MPa",
            {"x [mm]": 1e-3, "gap [mm]": 1e-3, "pressure [MPa]": 1e6, "force_n [N/mm]": 1e3},
        ),
        ("in-psi", {"x [in]": INCH, "pressure [psi]": PSI, "force_n [lbf/in]": LBF / INCH}),
    ):
        table = RESULT.contact.table(units=units)
        assert list(table.columns[:3]) == ["node", "pair", "state"] and table.shape == plain.shape
        for head, size in heads.items():
            name = head.partition(" [")[0]
            si = next(column for column in plain if column.startswith(f"{name} ["))
            np.testing.assert_allclose(table[head] * size, plain[si], rtol=1e-6)
        assert RESULT.pairs(units)["pair"].tolist() == RESULT.pairs()["pair"].tolist()
    assert (RESULT.contact.pressure == pressures).all()
    with pytest.raises(ValueError, match=r"units must be one of .*mm-MPa"):
        RESULT.contact.table(units="mm")


def test_pictures_have_the_units_that_are_set(chosen):
    chosen("in-psi")
    axes = am.plot.contact(RESULT).axes
    assert axes[0].get_ylabel().endswith("[psi]") and axes[2].get_xlabel() == "x [in]"
    assert axes[2].get_ylabel().endswith("[in]")
    curve = np.concatenate(
        [part.get_offsets() for part in axes[0].collections if len(part.get_offsets()) > 1]
    )
    assert np.isclose(curve[:, 1].max(), RESULT.contact.pressure.max() / PSI)
    assert np.isclose(np.ptp(curve[:, 0]), np.ptp(RESULT.contact.x[:, 0]) / INCH)
    bar = am.plot.deformation(RESULT, stress=True).axes[1]
    assert "[psi]" in bar.get_ylabel()
    assert f"pressure up to {RESULT.contact.pressure.max() / PSI:.3g} psi" in str(RESULT.contact)


def test_printed_texts_have_the_units_that_are_set(chosen):
    grids = am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 10e-3), contact_ratio=2)
    by_body = replace(grids, origin="graded {1: 0.02, pin: 5e-05} m, ratio 2 at contact")
    assert "(graded 0.02, 0.01 m, ratio 2 at contact)" in str(grids)
    result = am.solve(grids)
    size = float(result.advice[0].split("at most ")[1].split(" m ")[0])
    step, *_ = am.adapt(am.cases.greco_bar(), start=20e-3, max_nodes=20)
    chosen("mm-MPa")
    assert "(graded 20, 10 mm, ratio 2 at contact)" in str(grids)
    assert "(graded {1: 20, pin: 0.05} mm, ratio 2 at contact)" in str(by_body)
    assert f"at most {1e3 * size:.2g} mm there" in result.advice[0]
    assert am.Step.table([step])["pressure [MPa]"][0] == 1e-6 * step.result.max_pressure


def test_units_change_no_shape_of_a_curve(chosen):
    slip = np.abs(RESULT.contact.slip).max()

    def shape() -> np.ndarray:
        ax = am.plot.contact(RESULT).axes[2]
        (drawn,) = (line for line in ax.get_lines() if line.get_label().startswith("slip"))
        return np.array(ax.get_ylim()) * slip / np.abs(drawn.get_ydata()).max()

    metres = shape()
    assert 1e-6 < slip < metres[1] < 3 * slip
    for units in ("mm-MPa", "in-psi"):
        chosen(units)
        np.testing.assert_allclose(shape(), metres, rtol=0.01)


def test_reports_convert_columns_whose_unit_is_given(chosen):
    table = pd.DataFrame({"peak": [2e6], "n": [3]})

    def page() -> str:
        report = am.export.Report("A report")
        report.table(table, "Peaks", units={"peak": "Pa"}, formats={"peak": "g"})
        return report.page()

    assert "[Pa]" in page() and "[MPa]" not in page()
    chosen("mm-MPa")
    assert "[MPa]" in page() and ">2</t" in page() and table["peak"][0] == 2e6
