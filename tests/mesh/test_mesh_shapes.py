"""Elements of every shape become simplices that fit, whatever their numbers; decks are read with
their names."""

import itertools

import numpy as np
import pytest

import adaptmg as am
from adaptmg.mesh.contents import Contents, mesh_of
from adaptmg.mesh.shapes import KINDS, dimension, facets_of, middles, simplices

CORNERS = {
    "triangle": [(0, 0), (1, 0), (0, 1)],
    "quad": [(0, 0), (1, 0), (1, 1), (0, 1)],
    "tetra": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "pyramid": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)],
    "wedge": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)],
    "hexahedron": [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ],
}
SIZES = {
    "triangle": 0.5,
    "quad": 1,
    "tetra": 1 / 6,
    "pyramid": 1 / 3,
    "wedge": 0.5,
    "hexahedron": 1,
}
SOLID = [kind for kind in KINDS if dimension(kind) > 1]


def element(kind):
    """The points of one straight element."""
    corners = np.array(CORNERS[KINDS[kind][0]], dtype=float)
    return np.concatenate(
        [corners, *(corners[list(ends)].mean(axis=0)[None] for ends in middles(kind))]
    )


@pytest.mark.parametrize("kind", SOLID)
def test_cuts_fill_an_element_and_drop_no_node(kind):
    rng, dim, (shape, n) = np.random.default_rng(1), dimension(kind), KINDS[kind]
    placed = element(kind) @ (np.eye(dim) + 0.3 * rng.random((dim, dim)))
    size = SIZES[shape] * np.linalg.det(
        np.linalg.lstsq(element(kind) - element(kind)[0], placed - placed[0])[0]
    )
    for points in (placed, None):
        numbers = rng.permutation(n)
        x = np.empty_like(placed)
        x[numbers] = placed
        cells, owner = simplices(kind, numbers[None], None if points is None else x)
        sizes = np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]]) / (2, 6)[dim - 2]
        # oriented like the element
        assert sizes.sum() == pytest.approx(size, rel=1e-12) and (sizes / size).min() > 1e-4
        assert set(cells.ravel()) == set(range(n)) and not owner.any()


def bricks(kinds):
    """A box of 2 x 2 x 2 cells, each a brick or two wedges or six pyramids, with nodes numbered at
    random."""
    rng, points, cells = np.random.default_rng(2), {}, []

    def node(x):
        return points.setdefault(tuple(np.round(x, 9)), len(points))

    for k, corner in enumerate(itertools.product((0, 1), repeat=3)):
        kind, cube = kinds[k % len(kinds)], np.array(CORNERS["hexahedron"]) + corner
        shape, n = KINDS[kind]
        if shape == "hexahedron":
            parts = [cube]
        elif shape == "wedge":
            parts = [cube[[0, 1, 3, 4, 5, 7]], cube[[1, 2, 3, 5, 6, 7]]]
        else:
            parts = [
                np.vstack([cube[list(f)], cube.mean(axis=0)]) for _, f in facets_of("hexahedron")
            ]
        for part in parts:
            nodes = [*part, *(part[list(ends)].mean(axis=0) for ends in middles(kind))]
            assert len(nodes) == n
            cells.append((kind, np.array([[node(x) for x in nodes]])))
    x = np.array(list(points))
    numbers = rng.permutation(len(x))
    place = np.empty_like(x)
    place[numbers] = x
    return place, [(kind, numbers[nodes]) for kind, nodes in cells]


@pytest.mark.parametrize(
    "kinds",
    [
        ("hexahedron", "wedge", "pyramid"),
        ("hexahedron20", "wedge15", "pyramid13"),
        ("hexahedron27", "wedge18", "pyramid14"),
    ],
)
def test_cuts_fit_across_faces(kinds):
    for some in (kinds, *((kind,) for kind in kinds)):
        points, cells = bricks(some)
        low = [
            (kind, nodes[:, local])
            for whole, nodes in cells
            for kind, local in facets_of(whole)
            if (points[nodes[0, local], 2] == 0).all()
        ]
        contents = Contents(
            points,
            cells + low,
            {"low": [(len(cells) + k, np.zeros(1, int)) for k in range(len(low))]},
            {"top": np.flatnonzero(points[:, 2] == 2)},
        )
        # the mesh is checked: closed, no fold, nothing degenerate
        mesh, rest, _ = mesh_of(
            contents, unit=1e-3, unnamed="free", split_bodies=False, boundaries=None, body=None
        )
        assert (
            mesh.volumes.sum() == pytest.approx(8e-9) and mesh.n_nodes == len(points) and len(rest)
        )
        for name, z in (("low", 0), ("top", 2e-3)):
            surface = mesh.surface(name)
            assert (
                surface.measures.sum() == pytest.approx(4e-6)
                and (mesh.points[surface.nodes, 2] == z).all()
            )
        assert any("each split into" in note for note in mesh.notes)


#: Gmsh's numbers of kinds, and the corners whose middles and centres follow in its order
GMSH = {
    11: ("tetra", "01 12 20 30 23 13"),
    17: ("hexahedron", "01 03 04 12 15 23 26 37 45 47 56 67"),
    12: (
        "hexahedron",
        "01 03 04 12 15 23 26 37 45 47 56 67 0321 0154 0473 1265 2376 4567 01234567",
    ),
    13: ("wedge", "01 02 03 12 14 25 34 35 45 0143 0352 1254"),
    14: ("pyramid", "01 03 04 12 14 23 24 34 0321"),
    18: ("wedge", "01 02 03 12 14 25 34 35 45"),
    19: ("pyramid", "01 03 04 12 14 23 24 34"),
}


@pytest.mark.parametrize("number", GMSH)
def test_gmsh_counts_nodes_of_second_order_in_its_own_way(tmp_path, number):
    shape, between = GMSH[number]
    corners = np.array(CORNERS[shape], dtype=float)
    points = [*corners, *(corners[list(map(int, ends))].mean(axis=0) for ends in between.split())]
    nodes = "\n".join(f"{k + 1} {x} {y} {z}" for k, (x, y, z) in enumerate(points))
    (tmp_path / "m.msh").write_text(
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(points)}\n{nodes}\n$EndNodes\n$Elements\n1\n"
        f"1 {number} 2 3 3 {' '.join(map(str, range(1, len(points) + 1)))}\n$EndElements\n"
    )
    mesh = am.mesh.from_file(tmp_path / "m.msh", unnamed="free")
    # numbered otherwise, parts would be turned over
    assert (
        mesh.n_nodes == len(points)
        and mesh.bodies == ("3",)
        and mesh.volumes.sum() == pytest.approx(SIZES[shape])
    )
    assert f"1 {len(points)}-node" in mesh.notes[0]


#: types of Kratos, and the corners whose middles and centres follow in its order
KRATOS = {
    "Conditions LineLoadCondition2D3N": ("line", "01"),
    "Elements SmallDisplacementElement2D8N": ("quad", "01 12 23 30"),
    "Geometries Tetrahedra3D10": ("tetra", "01 12 20 03 13 23"),
    "Elements TotalLagrangianElement3D13N": ("pyramid", "01 12 23 30 04 14 24 34"),
    "Elements SmallDisplacementElement3D15N": ("wedge", "01 12 20 03 14 25 34 45 53"),
    "Elements SmallDisplacementElement3D20N": (
        "hexahedron",
        "01 12 23 30 04 15 26 37 45 56 67 74",
    ),
    "Geometries Hexahedra3D27": (
        "hexahedron",
        "01 12 23 30 04 15 26 37 45 56 67 74 0123 0154 1265 2376 3047 4567 01234567",
    ),
}


@pytest.mark.parametrize("name", [name for name, (shape, _) in KRATOS.items() if shape != "line"])
def test_kratos_counts_nodes_in_its_own_way_and_names_parts(tmp_path, name):
    rng, (shape, between) = np.random.default_rng(), KRATOS[name]
    corners = np.array(CORNERS[shape], dtype=float)
    points = [*corners, *(corners[list(map(int, ends))].mean(axis=0) for ends in between.split())]
    points = np.pad(points, ((0, 0), (0, 3 - len(corners[0]))))
    low = np.flatnonzero(points[:, points.any(axis=0)][:, -1] == 0)
    number = rng.permutation(np.arange(1, 3 * len(points)))[: len(points)]
    order = rng.permutation(len(points))
    keyword = name.split()[0]

    def block(name, rows):
        return [f"Begin {name} // a comment", *rows, f"End {name.split()[0]}"]

    rows = [f"{number[k]} {' '.join(map(str, points[k]))}" for k in order]
    text = ["Begin Properties 0", "End Properties", *block("Nodes", rows)]
    nodes = " ".join(map(str, number))
    text += block(name, [f"7 {'' if keyword == 'Geometries' else 0} {nodes}"])
    if shape == "quad":
        line = [f"7 0 {' '.join(map(str, number[[0, 1, 4]]))}"]
        text += block("Conditions LineLoadCondition2D3N", line)
    inner = block("SubModelPartNodes", map(str, number[low]))
    text += ["Begin SubModelPart Part // first", *block("SubModelPartNodes", map(str, number))]
    text += [*block(f"SubModelPart{keyword}", ["7"]), *block("SubModelPart Low", inner)]
    text += ["End SubModelPart", "Begin SubModelPart Load"]
    text += [*block("SubModelPartConditions", ["7"] * (shape == "quad")), "End SubModelPart"]
    (tmp_path / "m.mdpa").write_text("\n".join(text))
    mesh = am.mesh.from_file(tmp_path / "m.mdpa", unnamed="free")
    assert mesh.n_nodes == len(points) and mesh.bodies == ("Part",)
    assert mesh.volumes.sum() == pytest.approx(SIZES[shape])
    face = "Load" if shape == "quad" else "Part_Low"
    assert mesh.surface(face).measures.sum() == pytest.approx(
        0.5 if len(corners[0]) == 3 and shape in ("tetra", "wedge") else 1
    )
    text[-len(text) :] = [row.replace(f" {number[-1]}", " 999") for row in text]
    (tmp_path / "m.mdpa").write_text("\n".join(text))
    with pytest.raises(ValueError, match=r"m.mdpa': .*nodes that it does not hold, such as 999"):
        am.mesh.from_file(tmp_path / "m.mdpa")


def test_diagonals_without_neighbours_are_the_shorter_ones():
    for kind, pairs in (("quad", ((0, 2), (1, 3))), ("tetra10", ((4, 9), (5, 7), (6, 8)))):
        for stretch in np.exp(np.random.default_rng(3).normal(size=(8, dimension(kind)))):
            # sheared, so that no two diagonals are equal
            x = (
                element(kind) @ np.triu(np.full((dimension(kind),) * 2, 0.4), 1)
                + element(kind) * stretch
            )
            cells, _ = simplices(kind, np.arange(len(x))[None], x)
            shortest = min(pairs, key=lambda pair: np.linalg.norm(x[pair[0]] - x[pair[1]]))
            assert {
                frozenset(pair)
                for pair in pairs
                if any(set(pair) <= set(cell) for cell in cells.tolist())
            } == {frozenset(shortest)}


@pytest.mark.parametrize("kind", ["hexahedron", "wedge15"])
def test_twisted_elements_get_a_node_at_their_centre(kind):
    def twisted(x):
        angle = np.radians(50) * x[:, 2]
        y = x[:, :2] - x[x[:, 2] == 1, :2].mean(axis=0)
        return np.column_stack(
            [
                np.cos(angle) * y[:, 0] - np.sin(angle) * y[:, 1],
                np.sin(angle) * y[:, 0] + np.cos(angle) * y[:, 1],
                x[:, 2],
            ]
        )

    corners = twisted(np.array(CORNERS[KINDS[kind][0]], dtype=float))
    points = np.concatenate(
        [corners, *(corners[list(ends)].mean(axis=0)[None] for ends in middles(kind))]
    )
    for k in range(8):
        numbers = np.random.default_rng(k).permutation(len(points))
        mesh, *_ = mesh_of(
            Contents(points[np.argsort(numbers)], [(kind, numbers[None])]),
            unit=1.0,
            unnamed="free",
            split_bodies=False,
            boundaries=None,
            body="b",
        )
        assert mesh.n_nodes in (len(points), len(points) + 1) and mesh.bodies == ("b",)


def test_collapsed_bricks_are_wedges():
    points = np.array(CORNERS["wedge"], dtype=float)
    cells, _ = simplices("hexahedron", np.array([[0, 1, 2, 2, 3, 4, 5, 5]]), points)
    sizes = np.abs(np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])) / 6
    assert sizes.sum() == pytest.approx(0.5) and sizes.min() > 0


DECK = """** a comment
*Heading
 two blocks in mm
*Node, nset=Nall
1, 0., 0.
2, 10, 0
3, 10., 5.D0
4, , 5
11, 0, 5
12, 10, 5
13, 10, 12
14, 0, 12,
*Element, type=CPS4R, elset=Low
7, 1, 2,
3, 4
*ELEMENT, TYPE=CPS4, ELSET="High part"
8, 11, 12, 13, 14
*Elset, elset=Both
Low, High part
*Nset, nset=held, generate
1, 2
*Nset, nset=lid
13, 14
*Surface, name=Seat
Low, S3
*Surface, type=ELEMENT, name=foot
8, S1
*Material, name=Steel
*Elastic
210000., .3
*Solid section, elset=Both, material=Steel
*Surface interaction, name=I1
*Friction
0.25, 1e5
*Contact pair, interaction=I1
foot, Seat
*Boundary
held, 1, 2
"""


def test_a_deck_is_read_with_its_names(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(DECK)
    with pytest.warns(UserWarning, match='have no name in the file and are called "free"'):
        mesh = am.mesh.from_file(path, unit=1e-3)
    # a section is cut where nothing joins it, and each piece is called after the smallest set
    # around it
    assert mesh.bodies == ("Low", "High part") and np.bincount(
        mesh.element_body, mesh.volumes
    ) == pytest.approx([50e-6, 70e-6])
    assert set(mesh.boundaries) == {"free", "Seat", "foot", "held", "lid"}
    for name, y in (("Seat", 5e-3), ("foot", 5e-3), ("held", 0), ("lid", 12e-3)):
        assert (mesh.points[mesh.boundary_nodes(name), 1] == y).all() and len(
            mesh.boundary_facets(name)
        ) == 1
    for note in (
        "2 4-node quadrilaterals: each split into 2 triangles",
        "elements of the types CPS4, CPS4R",
        "material 'Steel': elastic constants 210000., .3 in the units of the file",
        "contact pair: foot, Seat",
        "friction 0.25 of 'I1'",
        "not read: *Boundary",
    ):
        assert note in mesh.notes
    assert am.mesh.from_file(path, boundaries=["lid"], unnamed="rest", body="all").bodies == (
        "all",
        "all_2",
    )


def test_names_that_overlap_go_to_the_smallest_or_the_first(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(DECK + "*Nset, nset=sides\n11, 12, 13, 14, 4, 1\n*Nset, nset=whole\nNall\n")
    mesh = am.mesh.from_file(path, unnamed="free")
    assert len(mesh.boundary_facets("lid")) == 1 and len(mesh.boundary_facets("sides")) == 3
    assert (
        "'sides': 2 of 5 facets belong to another name before it; boundaries= sets the order"
        in mesh.notes
    )
    assert any("set of all nodes of elements" in note and "whole" in note for note in mesh.notes)
    mesh = am.mesh.from_file(path, unnamed="free", boundaries=["sides", "Seat"])
    assert (
        set(mesh.boundaries) == {"sides", "Seat", "free"}
        and len(mesh.boundary_facets("sides")) == 5
    )
    # a set of all nodes is a boundary if it is asked for
    mesh = am.mesh.from_file(path, boundaries=["whole"])
    assert mesh.boundaries == ("whole",) and len(mesh.facets) == 8
    # a surface comes before a smaller set of nodes, and before one with the same name
    path.write_text(DECK + "*Surface, name=rim\n8, S2\n8, S3\n*Nset, nset=Seat\n1, 2\n")
    mesh = am.mesh.from_file(path, unnamed="free")
    assert len(mesh.boundary_facets("rim")) == 2 and "lid" not in mesh.boundaries
    assert (mesh.points[mesh.boundary_nodes("Seat"), 1] == 5).all()
    path.write_text(DECK + "*Surface, name=top, type=node\nlid\n")
    assert "top" in am.mesh.from_file(path, unnamed="free").boundaries
    with pytest.raises(ValueError, match="boundaries: it holds no 'side'; it holds"):
        am.mesh.from_file(path, boundaries=["side"])


def second_order_deck(rng, lines="T3D3"):
    """Two 8-node plates 2 x 1 side by side, as Gmsh writes a deck: blocks are called after entities,
    physical groups are sets of elements and of nodes; turned, shifted, numbered at random."""
    plate = element("quad8") * (2, 1)
    corners, angle = np.concatenate([plate, np.add(plate, (2, 0))]), rng.uniform(0, 7)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    places, row = np.unique(corners, axis=0, return_inverse=True)
    number = rng.permutation(np.arange(10, 10 + 3 * len(places)))[: len(places)]
    cells = number[row.reshape(2, 8)]
    x = places @ turn + rng.uniform(-9, 9, 2)

    def block(kind, name, rows):
        return [f"*ELEMENT, type={kind}, ELSET={name}", *(",".join(map(str, r)) for r in rows)]

    # along a line its middle comes second
    low, middle = [[k + 1, *cells[k, [0, 4, 1]]] for k in (0, 1)], [3, *cells[0, [1, 5, 2]]]
    text = [
        "*Heading",
        " m.inp",
        "*NODE",
        *(f"{n}, {a}, {b}, 0" for n, (a, b) in zip(number, x, strict=True)),
    ]
    text += ["******* E L E M E N T S *************"]
    text += (
        block(lines, "Line1", low[:1])
        + block(lines, "Line2", low[1:])
        + block(lines, "Line3", [middle])
    )
    text += block("CPS8", "Surface1", [[4, *cells[0]]]) + block(
        "CPS8", "Surface2", [[5, *cells[1]]]
    )
    for name, members in {"low": "1, 2", "mid": "3", "steel": "4", "brass": "5"}.items():
        text += [f"*ELSET,ELSET={name}", members]
    for name, rows in {"low": [0, 1, 4], "steel": range(8)}.items():
        text += [f"*NSET,NSET=nodes of {name}", ", ".join(str(n) for n in cells[0, list(rows)])]
    return "\n".join(text)


@pytest.mark.parametrize("lines", ["T3D3", "SAX2", "B32"])
def test_a_deck_of_gmsh_of_second_order_keeps_its_groups_and_whole_boundaries(tmp_path, lines):
    path = tmp_path / "m.inp"
    path.write_text(second_order_deck(np.random.default_rng(), lines))
    mesh = am.mesh.from_file(path, unnamed="free")
    assert mesh.bodies == ("steel", "brass") and mesh.volumes.sum() == pytest.approx(4)
    lengths = {name: mesh.surface(name).measures.sum() for name in mesh.boundaries}
    assert lengths == pytest.approx({"low": 4, "free": 6})
    assert any("'mid': 2 of 2 facets lie inside and are dropped" in note for note in mesh.notes)
    assert any("all nodes of elements" in note and "steel" in note for note in mesh.notes)
    apart = am.mesh.from_file(path, unnamed="free", split_bodies=True)
    assert apart.surface("steel.mid").measures.sum() == pytest.approx(1)
    # what no element has is said aloud
    path.write_text(
        path.read_text().replace("ELSET=Line1\n1,", "ELSET=Line1\n1, 99999,", 1)
        + "\n*NODE\n99999, 50, 50\n"
    )
    with pytest.warns(UserWarning, match=r"'low': 1 of 4 facets are facets of no element"):
        am.mesh.from_file(path, unnamed="free")


def test_an_included_file_is_named_with_its_line(tmp_path):
    (tmp_path / "all.inp").write_text("*HEADING\n part\n*INCLUDE, INPUT=part/nodes.inp\n")
    with pytest.raises(ValueError, match=r"all.inp': line 3: \*INCLUDE: .*no file .*nodes.inp"):
        am.mesh.from_file(tmp_path / "all.inp")
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "nodes.inp").write_text("\n*NODE\n1, 0, zero\n")
    with pytest.raises(
        ValueError, match=r"all.inp': in 'part/nodes.inp', line 2: \*NODE: could not"
    ):
        am.mesh.from_file(tmp_path / "all.inp")


def test_a_set_of_corners_holds_the_middle_nodes_between_them(tmp_path):
    x = 2 * element("quad8")
    rows = "\n".join(f"{k + 1}, {a}, {b}" for k, (a, b) in enumerate(x))
    (tmp_path / "m.inp").write_text(
        f"*NODE\n{rows}\n*ELEMENT, TYPE=CAX8R\n1, 1, 2, 3, 4, 5, 6, 7, 8\n*NSET, NSET=low\n1, 2\n"
    )
    mesh = am.mesh.from_file(tmp_path / "m.inp", unnamed="free")
    assert len(mesh.boundary_facets("low")) == 2 and "elements of the types CAX8R" in mesh.notes


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "*Node, nset",
            "*Node, system=C, nset",
            r"line 4: \*NODE: nodes and elements that the solver generates or moves",
        ),
        (
            "*Element, type=CPS4",
            "*Element, type=C3D4",
            "element of type C3D4R? has|tetrahedra|elements name|degenerate",
        ),
        ("7, 1, 2,", "7, 1, 99,", "nodes that it does not hold, such as 99"),
        ("Low, S3", "Low, S5", "face S5 of 4-node"),
        ("Low, S3", "Lower, S3", r"line 24: \*SURFACE: there is no set 'LOWER'"),
        ("2, 10, 0", "2, ten, 0", r"line 4: \*NODE: could not convert"),
        ("*Node, nset=Nall", "", "nodes that it does not hold, such as 1"),
        ("8, 11, 12, 13, 14", "8, 11, 12, 13", "has a number and 4 nodes"),
        (
            "*Node, nset",
            "*Part, name=P\n*Node, nset",
            r"line 4: \*PART: a deck of parts is not read; write it without",
        ),
    ],
)
def test_decks_are_refused_with_the_line(tmp_path, old, new, message):
    (tmp_path / "part.inp").write_text(DECK.replace(old, new, 1))
    with pytest.raises(ValueError, match=f"part.inp.*({message})"):
        am.mesh.from_file(tmp_path / "part.inp", unnamed="free")


@pytest.mark.parametrize("suffix", [".msh", ".inp"])
@pytest.mark.parametrize(
    "body", [am.Rectangle(width=2e-3, height=1e-3), am.Box(width=1e-3, depth=2e-3, height=3e-3)]
)
def test_names_come_back_from_a_file(tmp_path, body, suffix):
    mesh = am.mesh.merged(
        {"lower": am.mesh.structured(body, 2), "upper": am.mesh.structured(body, 3)}
    )
    am.export.mesh(mesh, tmp_path / f"m{suffix}", unit=1e-3)
    back = am.mesh.from_file(tmp_path / f"m{suffix}", unit=1e-3)
    assert back.boundaries == mesh.boundaries and back.bodies == mesh.bodies
    np.testing.assert_allclose(back.points, mesh.points, rtol=1e-14)
    for name in mesh.boundaries:
        np.testing.assert_array_equal(back.boundary_nodes(name), mesh.boundary_nodes(name))
    np.testing.assert_array_equal(np.bincount(back.element_body), np.bincount(mesh.element_body))
