"""Materials, loads, supports, laws, domains, contact and load paths that cannot be what was meant."""

import numpy as np
from hostile_table import Hostile

import adaptmg as am

_BAD = {"text": "1", "True": True, "complex": 1j, "nan": float("nan"), "list": [1.0], "class": float}


def _problem(**changes):
    parts = {"material": am.PlaneStrain(young=1e9, poisson=0.3), "law": am.Coulomb(0.3),
             "domain": am.Rectangle(width=1.0, height=1.0),
             "contact": am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))),
             "loads": (am.Pressure("top", 1e6),), "supports": (am.Support("right", x=0.0),)}
    return am.ContactProblem(**(parts | changes))


def _facing(gap):
    return am.Contact("bottom", am.GapFunction(gap))


def _masked(p):
    return np.ma.masked_array(0 * p[:, 0], mask=p[:, 0] > 0.2)


def _posed(**changes):
    return am.Hierarchy.uniform(_problem(**changes), divisions=(2, 4))


def _numbers():
    for label, value in _BAD.items():
        yield Hostile(f"young {label}", lambda v=value: am.PlaneStrain(young=v, poisson=0.3), "young")
        yield Hostile(f"poisson {label}", lambda v=value: am.Solid(young=1.0, poisson=v), "poisson")
        yield Hostile(f"pressure {label}", lambda v=value: am.Pressure("top", v), "value")
        yield Hostile(f"traction {label}", lambda v=value: am.Traction("top", (0.0, v)), "components")
        yield Hostile(f"limit {label}", lambda v=value: am.Tresca(v).bounds(2), "limit")
        yield Hostile(f"friction {label}", lambda v=value: am.Coulomb(v).bounds(2), "friction")
        yield Hostile(f"plane {label}", lambda v=value: am.Plane((0.0, v), (0.0, 1.0)), "point")
        yield Hostile(f"reach {label}", lambda v=value: am.ContactPair("a", "b", reach=v), "reach")
        yield Hostile(f"path {label}", lambda v=value: am.LoadPath({"top": [0.0, v]}), "factors['top']")
        yield Hostile(f"path default {label}", lambda v=value: am.LoadPath(default=[0.5, v]), "default")
        yield Hostile(f"vertices {label}", lambda v=value: am.Polygon(
            vertices=((0, 0), (1, 0), (v, 1)), boundaries=("a", "b", "c")), "vertices")
        yield Hostile(f"arc {label}", lambda v=value: am.Outline(
            vertices=((0, 0), (1, 0), (0, 1)), boundaries=("a", "b", "c"), arcs={1: (0, v)}), "arcs[1]")


INPUTS = (
    *_numbers(),
    # classes for instances
    Hostile("class law", lambda: _problem(law=am.Coulomb), "law"),
    Hostile("class law without parameters", lambda: _problem(law=am.Frictionless), "Frictionless(...)"),
    Hostile("class domain", lambda: _problem(domain=am.Rectangle), "domain"),
    Hostile("class material", lambda: _problem(material=am.PlaneStrain), "material"),
    Hostile("class materials", lambda: _problem(material={"body": am.PlaneStrain}), "material"),
    Hostile("class contact", lambda: _problem(contact=am.Contact), "contact"),
    Hostile("class load", lambda: _problem(loads=(am.Pressure,)), "loads[0]"),
    Hostile("class loads", lambda: _problem(loads=am.Pressure), "loads"),
    Hostile("class support", lambda: _problem(supports=(am.Support,)), "supports[0]"),
    Hostile("class obstacle", lambda: am.Contact("bottom", am.Plane), "obstacle"),
    Hostile("class part", lambda: am.Assembly(parts={"a": am.Rectangle}), "parts['a']"),
    Hostile("class solid", lambda: am.Moved(am.Ball), "solid"),
    Hostile("class in cut", lambda: am.Cut(am.Ball((0, 0, 0), 1.0), am.Ball), "b must be"),
    Hostile("class polygon", lambda: am.Revolution(am.Polygon), "polygon"),
    # other objects
    Hostile("loads None", lambda: _problem(loads=None), "loads"),
    Hostile("loads number", lambda: _problem(loads=5.0), "loads"),
    Hostile("loads text", lambda: _problem(loads="top"), "loads"),
    Hostile("loads mapping", lambda: _problem(loads={"top": am.Pressure("top", 1.0)}), "loads"),
    Hostile("load is support", lambda: _problem(loads=(am.Support("top", x=0.0),)), "loads[0]"),
    Hostile("support is load", lambda: _problem(supports=(am.Pressure("top", 1.0),)), "supports[0]"),
    Hostile("supports None", lambda: _problem(supports=None), "supports"),
    Hostile("contact None", lambda: _problem(contact=None), "contact"),
    Hostile("contact text", lambda: _problem(contact="bottom"), "contact"),
    Hostile("contact empty", lambda: _problem(contact=()), "contact"),
    Hostile("contact number", lambda: _problem(contact=3), "contact"),
    Hostile("law None", lambda: _problem(law=None), "law"),
    Hostile("law number", lambda: _problem(law=0.3), "law"),
    Hostile("material empty", lambda: _problem(material={}), "material"),
    Hostile("material number name", lambda: _problem(material={1: am.PlaneStrain(young=1.0, poisson=0.0)}), "material"),
    Hostile("moduli 1e39 : 1", lambda: _problem(material={name: am.PlaneStrain(young=young, poisson=0.3) for name, young
                                                          in (("a", 1e39), ("b", 1.0))}), "material: Young's moduli"),
    Hostile("name number", lambda: _problem(name=5), "name"),
    Hostile("name control", lambda: _problem(name="a\x00b"), "name"),
    Hostile("name surrogate", lambda: _problem(name="\ud800"), "name"),
    Hostile("reference text", lambda: _problem(reference="x"), "reference"),
    Hostile("interference text", lambda: am.Contact("bottom", am.Plane((0, 0), (0, 1)), allow_interference="no"),
            "allow_interference"),
    Hostile("pair interference number", lambda: am.ContactPair("a", "b", allow_interference=1), "allow_interference"),
    Hostile("pair coupling", lambda: am.ContactPair("a", "b", coupling="glue"), "coupling"),
    Hostile("pair gap True", lambda: am.ContactPair("a", "b", gap=True), "gap"),
    Hostile("surrogate boundary", lambda: _problem(loads=(am.Pressure("\udc80", 1.0),)), "boundary"),
    Hostile("boundary xml control", lambda: am.Support("a\x1b", x=0.0), "boundary"),
    Hostile("boundary list", lambda: am.Support(["right"], x=0.0), "boundary"),
    Hostile("boundary letters", lambda: am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries="abc"), "boundaries"),
    Hostile("boundaries number", lambda: am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries=5), "boundaries"),
    Hostile("outline boundaries None", lambda: am.Outline(vertices=((0, 0), (1, 0), (0, 1)), boundaries=None),
            "boundaries"),
    Hostile("vertices None", lambda: am.Polygon(vertices=None, boundaries=("a",)), "vertices"),
    Hostile("vertices ragged", lambda: am.Polygon(vertices=((0, 0), (1,), (0, 1)), boundaries=("a", "b", "c")),
            "vertices"),
    Hostile("vertices strings", lambda: am.Polygon(vertices=(("0", "0"), ("1", "0"), ("0", "1")),
                                                boundaries=("a", "b", "c")), "vertices"),
    Hostile("support text function", lambda: am.Support("right", x="0"), "x"),
    Hostile("components number", lambda: am.Traction("top", 5.0), "components"),
    Hostile("components None", lambda: am.BodyForce(None), "components"),
    Hostile("friction list of text", lambda: am.Coulomb(["1"]), "friction"),
    Hostile("friction masked", lambda: am.Coulomb(np.ma.masked), "friction"),
    Hostile("young ragged", lambda: am.PlaneStrain(young=[[1.0], [1.0, 2.0]], poisson=0.3), "young"),
    Hostile("plane of no dimension", lambda: am.Plane((), (0.0, 1.0)), "point"),
    Hostile("step file surrogate", lambda: am.StepFile("a\x00"), "path"),
    Hostile("friction ragged", lambda: am.Coulomb([[1.0], [1.0, 2.0]]), "friction"),
    # functions
    Hostile("friction function of text", lambda: _posed(law=am.Coulomb(lambda p: np.full(len(p), "1"))), "friction"),
    Hostile("friction function complex", lambda: _posed(law=am.Coulomb(lambda p: 1j * p[:, 0])), "friction"),
    Hostile("friction function None", lambda: _posed(law=am.Coulomb(lambda p: None)), "friction"),
    Hostile("friction function shape", lambda: _posed(law=am.Coulomb(lambda p: p)), "friction"),
    Hostile("friction function bool", lambda: _posed(law=am.Coulomb(lambda p: p[:, 0] > 0)), "friction"),
    Hostile("pressure function None", lambda: _posed(loads=(am.Pressure("top", lambda p: None),)), "top"),
    Hostile("pressure function complex", lambda: _posed(loads=(am.Pressure("top", lambda p: 1j * p[:, 0]),)), "top"),
    Hostile("pressure function text", lambda: _posed(loads=(am.Pressure("top", lambda p: "1"),)), "top"),
    Hostile("gap function None", lambda: _posed(contact=_facing(lambda p: None)), "gap"),
    Hostile("gap function complex", lambda: _posed(contact=_facing(lambda p: 1j * p[:, 0])), "gap"),
    Hostile("friction function masked", lambda: _posed(law=am.Coulomb(_masked)), "friction"),
    Hostile("gap function masked", lambda: _posed(contact=_facing(_masked)), "gap"),
    Hostile("gap function number", lambda: am.GapFunction(0.0), "function"),
    # the name of all contact boundaries
    Hostile("support on a boundary named contact", lambda: _problem(
        domain=am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=("bottom", "contact", "top", "left")),
        supports=(am.Support("contact", x=0.0),)), "'contact'"),
    Hostile("one of two contact boundaries named contact", lambda: _problem(
        domain=am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=("bottom", "contact", "top", "left")),
        contact=(_facing(lambda p: 0 * p[:, 0]), am.Contact("contact", am.GapFunction(lambda p: 0 * p[:, 0])))),
            "'contact'"),
    Hostile("a master named contact", lambda: _problem(
        domain=am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=("bottom", "contact", "top", "left")),
        contact=am.ContactPair("bottom", "contact")), "'contact'"),
    # absurd magnitudes
    Hostile("young 1e300", lambda: am.PlaneStrain(young=1e300, poisson=0.3), "young"),
    Hostile("young 1e-300", lambda: am.PlaneStrain(young=1e-300, poisson=0.3), "young"),
    Hostile("pressure 1e300", lambda: am.Pressure("top", 1e300), "value"),
    Hostile("traction 1e300", lambda: am.Traction("top", (1e300, 0.0)), "components"),
    Hostile("displacement 1e200", lambda: am.Support("right", x=1e200), "x"),
    Hostile("width 1e200", lambda: am.Rectangle(width=1e200, height=1.0), "width"),
    Hostile("width 1e-200", lambda: am.Rectangle(width=1e-200, height=1.0), "width"),
    Hostile("friction 1e300", lambda: am.Coulomb(1e300), "friction"),
    Hostile("limit 1e300", lambda: am.Tresca(1e300), "limit"),
    Hostile("poisson nearly one half", lambda: am.PlaneStrain(young=1.0, poisson=np.nextafter(0.5, 0)), "poisson"),
    Hostile("pressure function 1e300", lambda: _posed(loads=(am.Pressure("top", lambda p: 1e300),)), "top"),
    Hostile("strain 1e300", lambda: am.InitialStrain("body", (1e300, 0.0)), "components"),
    Hostile("path factor 1e300", lambda: am.LoadPath({"top": [1e300]}), "factors['top']"),
    Hostile("integer beyond float", lambda: am.Pressure("top", 10**400), "value"),
    # load paths
    Hostile("factors of a path text", lambda: am.LoadPath("top"), "factors"),
    Hostile("path factors text", lambda: am.LoadPath({"top": "12"}), "factors['top']"),
    Hostile("path factors bools", lambda: am.LoadPath({"top": [True, False]}), "factors['top']"),
    Hostile("path factors None", lambda: am.LoadPath({"top": None}), "factors['top']"),
    Hostile("path factors ragged", lambda: am.LoadPath({"top": [[1.0], [1.0, 2.0]]}), "factors['top']"),
    Hostile("path factors generator", lambda: am.LoadPath({"top": (k for k in range(3))}), "factors['top']"),
    Hostile("path name number", lambda: am.LoadPath({1: [1.0]}), "factors"),
    # cases
    Hostile("case size text", lambda: am.cases.greco_bar(size="1"), "size"),
    Hostile("case law class", lambda: am.cases.greco_bar(law=am.Coulomb), "law"),
    Hostile("case pressure True", lambda: am.cases.greco_bar(top_pressure=True), "top_pressure"),
    Hostile("case flag number", lambda: am.cases.greco_block(plane_strain=1), "plane_strain"),
    Hostile("case unknown", lambda: am.cases.get("\ud800"), "there is no case"),
)
