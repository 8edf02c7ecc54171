"""
Two bodies, and who is slave
============================

The contact conditions of a pair are posed on the first boundary, the slave. Meshes need not match.
Take the softer body and the smaller surface as slave; the other choice is solved as well, with more
cycles. A pair with ``sides="auto"`` chooses by itself."""

import adaptmg as am


def pair(slave, master):
    return am.ContactProblem(
        name=f"slave {slave}",
        law=am.Coulomb(0.3),
        contact=am.ContactPair(slave, master),
        domain=am.Assembly(
            parts={
                "bar": am.Rectangle(width=40e-3, height=40e-3),
                "block": am.Rectangle(width=60e-3, height=30e-3, origin=(-20e-3, -30e-3)),
            }
        ),
        material={
            "bar": am.PlaneStrain(young=7e10, poisson=0.3),
            "block": am.PlaneStrain(young=2.1e11, poisson=0.3),
        },
        loads=(am.Pressure("bar.top", 5e7), am.Pressure("bar.left", 15e7)),
        supports=(
            am.Support("bar.right", x=0.0),
            am.Support("block.right", x=0.0),
            am.Support("block.bottom", y=0.0),
        ),
    )


results = {}
for names in (("bar.bottom", "block.top"), ("block.top", "bar.bottom")):
    grids = am.Hierarchy.graded(pair(*names), sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
    results[f"slave {names[0]}"] = am.solve(grids)
    print(names[0], results[f"slave {names[0]}"].cycles, "cycles")

# %%
# Both sides of the pair carry the same force, with opposite signs.

result = results["slave bar.bottom"]
print(result.resultant("bar.bottom").force + result.resultant("block.top").force)  # N/m
am.plot.deformation(result, amplify=100, stress=True)

# %%
# **Next:** the cases ``dovetail`` and ``bolted_junction``; three bodies in a chain. **It depends on** your own
# problem; the theory is on :doc:`/theory/mortar`.
