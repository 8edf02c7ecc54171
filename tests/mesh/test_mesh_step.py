"""STEP files, written here by OCC: names and places survive, solids are meshed apart, what is
missing is said."""

import numpy as np
import pytest
import step_assembly
from netgen.occ import Axis, Box, Compound, Cylinder, Glue, Pnt, Sphere, Vec, X, Y, Z, gp_Dir

import adaptmg as am


def from_step(path, size, contact=(), ratio=1.0, *, unit=1e-3, names=None):
    return am.mesh.graded(am.StepFile(path, unit, names or {}), size, contact, ratio)


def step_names(path):
    faces = am.mesh.step_table(path)
    return {
        solid: tuple(own.face[own.face != ""]) for solid, own in faces.groupby("solid", sort=False)
    }


SIDES = ("left", "right", "front", "back", "bottom", "top")


def named_box(name, low, high):
    """Millimetres."""
    box = Box(Pnt(*low), Pnt(*high))
    for direction, pair in ((X, SIDES[:2]), (Y, SIDES[2:4]), (Z, SIDES[4:])):
        box.faces.Min(direction).name, box.faces.Max(direction).name = pair
    box.name = name
    return box


def two_boxes():
    return [named_box("lower", (0, 0, 0), (10, 20, 5)), named_box("upper", (0, 0, 5), (10, 20, 12))]


@pytest.fixture
def two(tmp_path):
    path = tmp_path / "two.step"
    Compound(two_boxes()).WriteStep(str(path))
    return path


def test_two_named_boxes(two):
    assert step_names(two) == {"lower": SIDES, "upper": SIDES}
    mesh = am.mesh.check_mesh(from_step(two, 5e-3))
    assert mesh.boundaries == tuple(f"{body}.{side}" for body in mesh.bodies for side in SIDES)
    # millimetres in the file, metres here; exactly in plane
    boxes = {
        "lower": ((0, 0, 0), (0.01, 0.02, 0.005)),
        "upper": ((0, 0, 0.005), (0.01, 0.02, 0.012)),
    }
    for (body, corners), volume in zip(
        boxes.items(), np.bincount(mesh.element_body, mesh.volumes), strict=True
    ):
        for k, side in enumerate(SIDES):
            assert (
                mesh.points[mesh.boundary_nodes(f"{body}.{side}"), k // 2] == corners[k % 2][k // 2]
            ).all()
        assert volume == pytest.approx(np.prod(np.subtract(*corners[::-1])), rel=1e-12)
    # bodies touch, but share no nodes; all nodes are sorted along the longest side
    nodes = [np.unique(mesh.elements[mesh.element_body == k]) for k in range(2)]
    assert len(np.intersect1d(*nodes)) == 0 and (np.diff(mesh.points[:, 1]) >= 0).all()


def test_sizes_by_body_and_by_face(two):
    mesh = from_step(two, {"lower": 5e-3, "upper": 2.5e-3})
    lower, upper = (np.median(mesh.element_sizes[mesh.element_body == k]) for k in range(2))
    assert 1.5 < lower / upper < 2.5
    mesh = from_step(two, 5e-3, "lower.top", 2.5)
    assert len(mesh.boundary_nodes("lower.top")) > 3 * len(mesh.boundary_nodes("upper.bottom"))
    # positions in m
    mesh = am.mesh.sized(am.StepFile(two), lambda x: 1.5e-3 + 0.5 * x[:, 2], 5e-3)
    assert len(mesh.boundary_nodes("lower.bottom")) > 2 * len(mesh.boundary_nodes("upper.top"))


def test_renaming(two):
    domain = am.StepFile(
        two,
        names={
            "solid2": "punch",
            "upper.face5": "contact",
            "lower.top": "seat",
            "solid1.left": "symmetry",
        },
    )
    assert domain.boundaries is None and domain.bodies is None and domain.dim == 3
    assert step_names(domain) == {
        "lower": ("symmetry", *SIDES[1:5], "seat"),
        "punch": (*SIDES[:4], "contact", "top"),
    }
    mesh = am.mesh.graded(domain, 5e-3, "punch.contact", 2.5)
    assert (mesh.points[mesh.boundary_nodes("punch.contact"), 2] == 0.005).all()
    # several faces may share a name
    everything = from_step(two, 1e-2, names={f"lower.face{k}": "skin" for k in range(1, 7)})
    assert len(everything.boundary_facets("lower.skin")) == (everything.facet_labels == 0).sum()
    assert "lower.skin" in everything.boundaries and "lower.top" not in everything.boundaries


def test_files_without_names(tmp_path):
    path = tmp_path / "pins.stp"
    pin = Cylinder(Pnt(0, 0, 0), Z, 1, 2)
    # copies beside it, and oblique and far away
    oblique = pin.Rotate(Axis(Pnt(0, 0, 0), X), 30).Move(Vec(500, 0, 0))
    Compound([pin, pin.Move(Vec(5, 0, 0)), oblique]).WriteStep(str(path))
    assert step_names(path) == {f"solid{k}": ("face1", "face2", "face3") for k in (1, 2, 3)}
    mesh = from_step(path, 1e-3, "solid1.face2", 4)
    np.testing.assert_allclose(
        np.bincount(mesh.element_body, mesh.volumes), np.pi * 2e-9, rtol=0.06
    )
    # a size on a face is not one on its copies
    fine, *others = (len(mesh.boundary_facets(f"solid{k}.face2")) for k in (1, 2, 3))
    assert fine > 2 * max(others)
    sides = mesh.points[mesh.boundary_nodes("solid1.face1")]
    np.testing.assert_allclose(np.linalg.norm(sides[:, :2], axis=1), 1e-3, rtol=1e-12)
    axis = np.array([0, -np.sin(np.pi / 6), np.cos(np.pi / 6)])
    sides = mesh.points[mesh.boundary_nodes("solid3.face1")] - (0.5, 0, 0)
    np.testing.assert_allclose(np.linalg.norm(np.cross(sides, axis), axis=1), 1e-3, rtol=1e-9)


def test_names_in_a_file_and_glued_solids(tmp_path):
    path = tmp_path / "glued.step"
    named_box("a.b", (0, 0, 0), (1, 1, 1)).WriteStep(str(path))
    assert step_names(path) == {"a_b": SIDES}
    Compound([named_box("bolt", (10 * k, 0, 0), (10 * k + 1, 1, 1)) for k in range(3)]).WriteStep(
        str(path)
    )
    assert list(step_names(path)) == ["bolt", "bolt_2", "bolt_3"]
    Glue(two_boxes()).WriteStep(str(path))
    mesh = from_step(path, 5e-3, names={"upper.face5": "bottom"})
    assert not set(mesh.boundary_nodes("lower.top")) & set(mesh.boundary_nodes("upper.bottom"))


def test_units(two):
    metres = two.with_name("metres.step")
    metres.write_text(two.read_text().replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)"))
    for mesh in (from_step(metres, 5.0), from_step(two, 5.0, unit=1.0)):
        np.testing.assert_allclose(mesh.points.max(axis=0), (10, 20, 12), rtol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"names": {"middle": "x"}},
            "names: 'middle' is neither a solid nor a 'solid.face' of .*it holds lower: left, r",
        ),
        ({"names": {"lower.lid": "x"}}, "names: 'lower.lid' is neither"),
        ({"names": {"lower": "upper"}}, "two solids are called 'upper'"),
        (
            {"contact": "top"},
            "boundary 'top' does not exist; the boundaries are lower.left, lower.right",
        ),
        ({"size": {"lower": 1e-3}}, "size must name each body once"),
        ({"size": 1e-6}, "nodes .at most 2e"),
    ],
)
def test_bad_arguments(two, arguments, message):
    with pytest.raises(ValueError, match=message):
        from_step(two, **({"size": 5e-3} | arguments))


@pytest.fixture(scope="module")
def clamped(tmp_path_factory):
    """A plate on a pin with a clearance of .1 mm, three nuts, two of them on the plate; mm."""
    plate = Box(Pnt(0, 0, 0), Pnt(20, 20, 5)) - Cylinder(Pnt(5, 5, 0), Z, 2.1, 5)
    nut, pin = (
        Cylinder(Pnt(0, 0, 0), Z, 4, 3) - Cylinder(Pnt(0, 0, 0), Z, 2, 3),
        Cylinder(Pnt(0, 0, 0), Z, 2, 9),
    )
    return step_assembly.write(
        tmp_path_factory.mktemp("step") / "clamped.step",
        {"plate": plate, "nut": nut, "pin": pin},
        [
            ("plate", "plate:1", (0, 0, 0)),
            ("nut", "NAUO1", (5, 5, 5)),
            ("nut", "", (5, 5, -3)),
            ("pin", "pin:7", (5, 5, -2)),
            ("nut", "nut:4", (15, 15, 5.5)),
        ],
    )


def test_products_name_the_solids_of_an_assembly(clamped):
    assert list(step_names(clamped)) == ["plate", "nut", "nut_2", "pin", "nut_3"]
    assert list(step_names(am.StepFile(clamped, solids=["pin", "nut.2"]))) == ["pin", "nut_2"]
    assert list(step_names(am.StepFile(clamped, solids=["nut"]))) == ["nut", "nut_2", "nut_3"]
    domain = am.StepFile(clamped, names={"nut_2": "lower"}, solids=("lower", "plate"))
    mesh = am.mesh.graded(domain, 4e-3)
    assert mesh.bodies == ("lower", "plate") and mesh.points[:, 2].min() == pytest.approx(-3e-3)
    for wrong in ("nuts", "nut.4", "nut.0"):
        with pytest.raises(
            ValueError, match=f"there is no solid '{wrong}'.*holds plate, nut, nut_2, pin, nut_3"
        ):
            step_names(am.StepFile(clamped, solids=[wrong]))


@pytest.mark.parametrize("name", ["assembly", r"Gr\X2\00FC\X0\n", r"\X\C4ste", "the team''s", " "])
def test_instances_without_names_are_called_after_their_product(clamped, tmp_path, name):
    path, text = tmp_path / "a.step", clamped.read_text()
    for k, own in enumerate(("plate:1", "NAUO1", "", "pin:7", "nut:4")):
        old = f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{k}','{own}','',"
        assert old in text
        text = text.replace(old, f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{k}', /* */ '=>[0:1:1:{k}]','',")
    path.write_text(text.replace("PRODUCT('assembly','assembly'", f"PRODUCT('1','{name}'"))
    assert list(step_names(path)) == ["plate", "nut", "nut_2", "pin", "nut_3"]


def test_a_table_knows_the_outside_of_a_turned_solid(tmp_path):
    rng, path = np.random.default_rng(), tmp_path / "turned.step"
    solid = Box(Pnt(0, 0, 0), Pnt(9, 7, 5)) - Box(Pnt(2, 2, 2), Pnt(4, 4, 6))
    turn = Axis(Pnt(1, 2, 3), gp_Dir(*rng.normal(size=3)))
    solid = solid.Rotate(turn, rng.uniform(0, 360)).Move(Vec(*rng.uniform(-50, 50, 3)))
    solid.WriteStep(str(path))
    table = am.mesh.step_table(path)
    faces = table[table.face != ""]
    normals = faces[["nx", "ny", "nz"]].to_numpy()
    # of a polyhedron the areas add up to 0, and its volume is the sum of cones, by Gauss
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    np.testing.assert_allclose(faces.area @ normals, 0, atol=1e-15)
    heights = (normals * faces[["x", "y", "z"]]).sum(axis=1)
    assert faces.area @ heights / 3 == pytest.approx((9 * 7 * 5 - 2 * 2 * 3) * 1e-9)
    whole = table[table.face == ""]
    for size in ("dx", "dy", "dz"):
        assert (faces[size] <= whole[size].item() * (1 + 1e-6)).all()


def test_a_table_finds_faces_by_what_they_are_like(clamped, tmp_path):
    table = am.mesh.step_table(clamped)
    solids = table[table.kind == "solid"].set_index("solid")
    assert solids.volume["pin"] == pytest.approx(np.pi * 36e-9) and solids.z[
        "nut_2"
    ] == pytest.approx(-1.5e-3)
    assert solids.loc["plate", ["dx", "dy", "dz"]].tolist() == pytest.approx(
        [20e-3, 20e-3, 5e-3], rel=1e-6
    )
    upper = table[(table.solid == "plate") & (table.nz > 0.99)]
    assert len(upper) == 1 and upper.area.item() == pytest.approx((400 - np.pi * 2.1**2) * 1e-6)
    assert upper.z.item() == pytest.approx(5e-3) and np.isnan(upper.radius.item())
    round_ = table[table.kind == "cylinder"]
    assert sorted(round_.radius) == pytest.approx([2e-3] * 4 + [2.1e-3] + [4e-3] * 3)
    # outward, whatever the orientation of a face in the file
    for _, faces in table[table.kind == "plane"].groupby("solid"):
        own = solids.loc[faces.solid.iloc[0]]
        assert (
            (faces.x - own.x) * faces.nx
            + (faces.y - own.y) * faces.ny
            + (faces.z - own.z) * faces.nz
            > 0
        ).all()
    Sphere(Pnt(1, 2, 3), 4).WriteStep(str(tmp_path / "ball.step"))
    ball = am.mesh.step_table(am.StepFile(tmp_path / "ball.step", unit=1.0)).iloc[1]
    assert (ball.kind, ball.radius) == ("sphere", pytest.approx(4)) and ball.area == pytest.approx(
        64 * np.pi
    )


def test_faces_that_lie_on_each_other_are_pairs(clamped):
    table = am.mesh.step_table(clamped).set_index(["solid", "face"])

    def found(**options):
        return {(pair.slave, pair.master) for pair in am.mesh.touching(clamped, **options)}

    tight = found()
    # the smaller face is the slave: a nut is screwed on the pin, and one sits on the plate
    assert {(a.split(".")[0], b.split(".")[0]) for a, b in tight} == {
        ("nut", "plate"),
        ("nut_2", "plate"),
        ("nut", "pin"),
        ("nut_2", "pin"),
    }
    for slave, master in tight:
        a, b = (table.loc[tuple(name.split("."))] for name in (slave, master))
        assert a.area <= b.area and (a.kind, b.kind) in (
            ("plane", "plane"),
            ("cylinder", "cylinder"),
        )
        assert a.kind == "cylinder" or a.nz * b.nz == pytest.approx(-1)
    loose = found(tolerance=0.15e-3) - tight
    radii = [table.loc[tuple(name.split(".")), "radius"] for pair in loose for name in pair]
    assert radii == pytest.approx([2.1e-3, 2e-3])
    assert found(tolerance=0.6e-3) - tight - loose == {("nut_3.face3", "plate.face3")}


def test_a_step_file_is_drawn_with_its_faces(two):
    domain = am.StepFile(two)
    posed = am.ContactProblem(
        domain=domain,
        material=am.Solid(young=2e11, poisson=0.3),
        law=am.Coulomb(0.2),
        contact=am.mesh.touching(domain),
        supports=[am.Support("lower.bottom", x=0, y=0, z=0)],
        loads=[am.Pressure("upper.top", 1e6)],
    )
    texts = {text.get_text() for text in am.plot.problem(posed).axes[0].texts}
    assert len(texts) >= 3 and texts <= {
        f"{body}.{side}" for body in ("lower", "upper") for side in SIDES
    }


def test_bad_files(tmp_path):
    surface, other = tmp_path / "surface.step", tmp_path / "mesh.msh"
    Compound([Cylinder(Pnt(0, 0, 0), Z, 1, 4).faces[0]]).WriteStep(str(surface))
    other.write_text("")
    for call, error, message in (
        (
            lambda: from_step(tmp_path / "none.step", 1e-3),
            FileNotFoundError,
            "path: there is no file",
        ),
        (lambda: from_step(surface, 1e-3), ValueError, "holds no solids; surfaces must be closed"),
        (lambda: from_step(other, 1e-3), ValueError, r"is not a \.step or \.stp file"),
        (lambda: am.mesh.as_mesh(surface), ValueError, "StepFile"),
    ):  # a geometry is no mesh
        with pytest.raises(error, match=message):
            call()
