"""
A friction sweep on one set of meshes
=====================================

A study is a function and a design. Meshes, matrices and transfers do not depend on friction: they
are made once, outside the function, and each run takes them with another law. Where a parameter
changes the meshes, a cached function makes them: :doc:`/howto/study`."""

import matplotlib.pyplot as plt

import adaptmg as am

grids = am.Hierarchy.graded(
    am.cases.greco_bar(), sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4
)


def run(friction):
    result = am.solve(grids.with_problem(am.cases.greco_bar(law=am.Coulomb(friction))))
    slipping = (result.contact.state == am.SLIP).mean()
    return {"cycles": result.cycles, "work_units": result.work_units, "slipping": slipping}


study = am.Study(run, {"friction": [0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2]}, store="friction.sqlite")
table = study.run()
table[["friction", "cycles", "work_units", "slipping"]]

# %%
# Each run is stored when it ends. The same script computes nothing again, unless its code or
# adaptmg has changed. The study adds the columns ``status``, ``seconds`` and ``error``, with
# ``table(details=True)`` also ``peak_memory``, ``started``, ``finished``, ``machine``, ``commit``
# and ``traceback``; where a parameter or a result has such a name, they begin with ``run_``.

figure, ax = plt.subplots(layout="constrained")
ax.plot(table["friction"], 100 * table["slipping"], "o-")
_ = ax.set(xlabel="friction", ylabel="contact nodes that slip [%]", ylim=(0, 100))

# %%
# **Next:** ``study.run(workers=4)`` computes on four processes; ``am.study.LatinHypercube`` and
# ``am.study.Sobol`` are designs of random points; :doc:`/howto/cluster`. **It depends on** the bar in ten lines.
