"""Do bodies hit each other with the right force, and rebound with the right energy?

    python studies/impact.py [--quick | --full] [--out DIR]

A bar of 10 x 1 m flies at 10 m/s against a wall (Doyen, Ern, Piperno 2011): the closed form is a
force of 300 N/m from .5 s to 1.1667 s, after which no energy is lost. The time step is the time in
which a wave passes a cell; a step is one contact problem, and each tenth one is certified. What is
lost in contact is the energy of the outermost layer of nodes, whose velocity the wall takes.

Two equal bars exchange their velocities, and friction stops a block after v^2 / (2 mu g). The
moving picture is a ball (E 50 MPa) that falls on a beam (2 GPa), which is held at both ends."""

import json
import time
import warnings

import numpy as np
from common import Output, drawing, main
from matplotlib import pyplot as plt

import adaptmg as am


def bar(cells: int) -> tuple[am.Hierarchy, am.Dynamics]:
    """The bar on nested grids, with some cells across on the finest."""
    across = [cells // 2**k for k in (3, 2, 1, 0) if cells // 2**k]
    grids = am.Hierarchy.uniform(am.cases.impact_bar(), [(n, 10 * n) for n in across])
    step = 1.0 / cells / grids.problem.reference["wave_speed"]
    return grids, am.Dynamics(density=1.0, initial_velocity=(0.0, -10.0), step=step, end=1.3)


def hit(cells: int) -> dict:
    """Force, times and energy of the bar, and what a time step costs; the force over time, as JSON."""
    grids, dynamics = bar(cells)
    reference = grids.problem.reference
    steps = am.march(grids, dynamics)
    next(steps)  # compiles
    rows = []
    begin = time.process_time()
    for result in steps:
        force = result.resultant("contact").force[1]
        left = result.energies["kinetic"] + result.energies["strain"]
        rows.append((result.time - 0.5 * dynamics.step, force, left, result.cycles))
    seconds = time.process_time() - begin
    times, forces, energies, cycles = np.array(rows).T
    pressed, touching = forces[(times > 0.6) & (times < 1.05)], times[forces > 0.3]
    return {
        "nodes": grids.finest.n_nodes,
        "steps": dynamics.n_steps,
        "force": pressed.mean(),
        "deviation": pressed.std(),
        "begin_error": touching[0] / reference["begin"] - 1,
        "end_error": touching[-1] / reference["end"] - 1,
        "energy_left": energies[-1] / energies[0],
        "cycles": cycles.mean(),
        "step_ms": 1e3 * seconds / len(rows),
        "curve": json.dumps([times.tolist(), forces.tolist()]),
    }


def posed(
    domain: am.problem.Domain, contact: am.Contact | am.ContactPair, law: am.problem.Law, *loads
) -> am.Hierarchy:
    """Grids of blocks in contact."""
    material = am.PlaneStrain(young=1e8, poisson=0.0)
    problem = am.ContactProblem(
        domain=domain, material=material, contact=contact, law=law, loads=loads
    )
    return am.Hierarchy.uniform(problem, [(16, 4), (32, 8)])


def bars() -> tuple[float, float]:
    """Error of the velocities of two bars after their impact; largest rise of the energy."""
    left, right = (am.Rectangle(width=0.4, height=0.1, origin=(x, 0)) for x in (0.0, 0.4001))
    domain = am.Assembly(parts={"left": left, "right": right})
    grids = posed(domain, am.ContactPair("left.right", "right.left"), am.Frictionless())
    flying = {"left": (0.5, 0.0)}
    dynamics = am.Dynamics(density=1000.0, initial_velocity=flying, step=2e-5, end=2.8e-3)
    results = list(am.march(grids, dynamics, rtol=1e-12))
    mesh = am.mesh.need_mesh(grids.finest)
    velocity = results[-1].velocity[:, 0]
    first, second = (velocity[mesh.elements[mesh.element_body == k]].mean() for k in (0, 1))
    energies = [result.energies["kinetic"] + result.energies["strain"] for result in results]
    return max(abs(first), abs(second - 0.5)) / 0.5, np.diff(energies).max() / energies[0]


def block() -> tuple[float, float]:
    """Error of the distance that a block slides until friction stops it."""
    friction, weight, density = 0.3, 9.81, 2000.0
    floor = am.Contact("bottom", am.Plane(point=(0, 0), normal=(0, 1)))
    body, load = am.Rectangle(width=0.4, height=0.1), am.BodyForce((0.0, -density * weight))
    grids = posed(body, floor, am.Coulomb(friction), load)
    rest = am.solve(grids)
    stop = 1 / (friction * weight)
    times = {"step": stop / 100, "end": 1.1 * stop, "damping": stop / 300}
    dynamics = am.Dynamics(density=density, initial_velocity=(1.0, 0.0), **times)
    *_, last = am.march(grids, dynamics, start=rest)
    distances = (last.displacement - rest.displacement)[:, 0]
    return np.abs(2 * friction * weight * distances - 1).max(), np.nan


def form(case: str) -> dict:
    """Errors of a closed form."""
    error, rise = bars() if case == "velocities of two bars" else block()
    return {"error": error, "rise": rise}


def ball(out: Output) -> None:
    """Draw a ball that falls on a beam, frame by frame."""
    centre, angles = (0.0, 0.0105), np.radians([200, 340, 90])
    corners = [(0.01 * np.cos(angle), centre[1] + 0.01 * np.sin(angle)) for angle in angles]
    names, arcs = ("foot", "right", "left"), dict.fromkeys(range(3), centre)
    disc = am.Outline(vertices=tuple(corners), boundaries=names, arcs=arcs)
    beam = am.Rectangle(width=0.12, height=0.004, origin=(-0.06, -0.004))
    ends = [am.Support(f"beam.{name}", x=0, y=0) for name in ("left", "right")]
    young = {"ball": 5e7, "beam": 2e9}
    problem = am.ContactProblem(
        domain=am.Assembly(parts={"ball": disc, "beam": beam}),
        material={name: am.PlaneStrain(young=value, poisson=0.3) for name, value in young.items()},
        contact=am.ContactPair("ball.foot", "beam.top"),
        law=am.Coulomb(0.3),
        supports=ends,
        elements="smoothed",
    )
    sizes = [{"ball": 3e-3 / n, "beam": 2e-3 / n} for n in ((0.5, 1) if out.quick else (1, 2))]
    grids = am.Hierarchy.graded(problem, sizes, contact_ratio=2)
    last = 2e-4 if out.quick else 3e-3
    flying = {"ball": (0.0, -8.0)}
    dynamics = am.Dynamics(density=1200.0, initial_velocity=flying, step=1e-5, end=last)
    figure, axes = plt.subplots(2, 1, figsize=(7.2, 4.4), height_ratios=(3, 2))
    mesh = am.mesh.need_mesh(grids.finest)
    end = 1e3 * dynamics.end
    history = []

    def frames():
        for k, result in enumerate(am.march(grids, dynamics)):
            kinetic, strain, _, *lost = result.energies.values()
            history.append((1e3 * result.time, kinetic, strain, sum(lost)))
            if k % 5:
                continue
            for ax in axes:
                ax.clear()
            x, y = 1e3 * (mesh.points + result.displacement).T
            speed = np.linalg.norm(result.velocity, axis=1)
            axes[0].tripcolor(x, y, mesh.elements, speed, shading="gouraud", vmin=0, vmax=12)
            axes[0].set(xlim=(-62, 62), ylim=(-14, 26), aspect="equal", ylabel="y [mm]")
            axes[0].set_title(
                f"{1e3 * result.time:.2f} ms; colours: speed, 0 to 12 m/s", fontsize=9
            )
            times, *energies = np.array(history).T
            axes[1].stackplot(times, energies, labels=("kinetic", "strain", "lost"))
            axes[1].set(
                xlim=(0, end), ylim=(0, history[0][1]), xlabel="time [ms]", ylabel="energy [J/m]"
            )
            axes[1].legend(loc="lower right", fontsize=8)
            yield figure

    out.animation("ball", frames(), "A ball falls on a beam; its energy goes into waves, and stays")
    plt.close(figure)


def study(out: Output) -> None:
    """Compute the bar on finer and finer meshes, the other closed forms, and the pictures."""
    # the published bar is strained by a third
    warnings.filterwarnings("ignore", message="strains exceed")
    cells = [4, 8] if out.quick else [4, 8, 16, 32] if out.full else [4, 8, 16]
    table = am.Study(hit, {"cells": cells}, out.store).run(throw=True)
    out.table(
        "bar",
        table.loc[:, "nodes":"step_ms"],
        "A bar that hits a wall: 300 N/m from .5 s to 1.1667 s",
        "Force and deviation from .6 to 1.05 s; times of the first and the last step with a force.",
        units={"force": "N/m", "deviation": "N/m"},
        formats={"energy_left": ".4f"}
        | dict.fromkeys(("begin_error", "end_error"), ".2%")
        | dict.fromkeys(("force", "deviation", "cycles", "step_ms"), ".2f"),
    )
    cases = ["velocities of two bars", "distance until friction stops a block"]
    forms = am.Study(form, {"case": cases}, out.store).run(throw=True)
    out.table(
        "forms",
        forms[["case", "error", "rise"]],
        "Closed forms of motion",
        "Relative errors, and the largest rise of the energy in a step.",
        formats=dict.fromkeys(("error", "rise"), ".1e"),
    )
    figure, ax = drawing()
    for _, row in table.iloc[:2].iterrows():
        ax.plot(*json.loads(row["curve"]), label=f"{row['nodes']} nodes")
    ax.plot([0.4, 0.5, 0.5, 3.5 / 3, 3.5 / 3, 1.3], [0, 0, 300, 300, 0, 0], "k:")
    ax.set(xlabel="time [s]", ylabel="contact force [N/m]", xlim=(0.4, 1.3))
    figure.legend(loc="outside right upper")
    out.figure("force", figure, "The force of the bar on the wall; dotted: closed form")
    ball(out)
    last = table.iloc[-1]
    out.number(
        f"Impact of a bar, {last['nodes']:.0f} nodes: force (300 N/m); energy left; cycles, ms a step",
        "{force:.1f} ± {deviation:.1f}; {energy_left:.1%}; {cycles:.1f}, {step_ms:.1f}".format(
            **last
        ),
    )
    out.check("error of the force", abs(last["force"] / 300 - 1), high=0.01)
    out.check("error of closed forms of motion", forms["error"].max(), high=0.03)
    out.check("largest rise of energy without friction", forms["rise"].max(), high=1e-10)


if __name__ == "__main__":
    main(study)
