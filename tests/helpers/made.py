"""Meshes and results made by hand, for tests of what only reads them. No NGSolve, no solver."""

from dataclasses import replace

import numpy as np

import adaptmg as am


def square(n: int, size: float = 0.04) -> am.MeshArrays:
    """n x n squares cut in two; boundaries bottom, right, top, left."""
    return replace(am.mesh.structured(am.Rectangle(width=size, height=size), n))


def cube(n: int, size: float = 0.04) -> am.MeshArrays:
    """n x n x n cubes cut in six tetrahedra; boundaries bottom (z = 0) and rest."""
    mesh = am.mesh.structured(am.Box(width=size, depth=size, height=size), n)
    return replace(
        mesh,
        facet_labels=np.where(mesh.facet_labels == mesh.boundaries.index("bottom"), 0, 1),
        boundaries=("bottom", "rest"),
    )


def result_on(mesh: am.MeshArrays | None, **changes: object) -> am.Result:
    """A result with smooth made-up fields: open, slip and stick zones along the first axis of
    'bottom'."""
    drawn = square(4) if mesh is None else mesh
    dim, nodes = drawn.dim, drawn.boundary_nodes("bottom")
    x, size = drawn.points[nodes], np.ptp(drawn.points[:, 0])
    s = x[:, 0] / size
    normal = -np.eye(dim)[dim - 1]
    frames = np.zeros((len(nodes), dim, dim))
    frames[:, 0] = normal
    frames[:, 1, 0] = 1.0
    if dim == 3:
        frames[:, 2] = np.cross(normal, [1.0, 0.0, 0.0])
    weights = np.full(len(nodes), (size / np.sqrt(len(nodes))) ** (dim - 1))
    pressure = 8e7 * np.clip(s - 0.1, 0, None) * (1.4 - s)
    traction = np.minimum(pressure, 5e7 * (1 - s))
    slip = np.zeros((len(nodes), dim - 1))
    slip[:, 0] = 3e-5 * np.clip(0.7 - s, 0, None)
    force_t = np.zeros_like(slip)
    force_t[:, 0] = -traction * weights
    state = np.where(s <= 0.1, am.OPEN, np.where(s < 0.7, am.SLIP, am.STICK)).astype(np.int8)
    contact = am.solver.ContactResult(
        node=nodes,
        x=x if mesh is not None else np.full_like(x, np.nan),
        frames=frames,
        gap=2e-5 * np.clip(0.1 - s, 0, None),
        u_n=np.zeros(len(nodes)),
        u_t=slip,
        slip=slip,
        force_n=pressure * weights,
        force_t=force_t,
        weights=weights,
        limit=pressure * weights,
        state=state,
        boundary=np.zeros(len(nodes), int),
        names=("bottom",),
        masters=("",),
        master_node=np.empty(0, dtype=np.int64),
        master_force=np.empty((0, dim)),
        master_boundary=np.empty(0, dtype=np.int64),
        master_is_slave=np.empty(0, dtype=bool),
        measures=weights,
    )
    displacement = np.zeros(drawn.points.shape)
    displacement[:, 0] = 1e-3 * (size - drawn.points[:, 0])
    displacement[:, -1] = -3e-4 * drawn.points[:, -1]
    cycle = np.arange(12)
    history = {
        "cycle": cycle,
        "work_units": 3.0 + 4.0 * cycle,
        "seconds": 0.1 * cycle,
        "residual": 1e-2 * 0.2**cycle,
        "change": np.where(cycle, 3e-2 * 0.2**cycle, np.nan),
        "error_estimate": np.where(cycle, 1e-2 * 0.2**cycle, np.inf),
    }
    way = [
        (0, "solve", 40),
        (1, "start", 1),
        (1, "smooth", 2),
        (1, "restrict", 1),
        (0, "solve", 12),
        (1, "prolong", 1),
        (2, "start", 1),
    ]
    for _ in range(12):
        way += [
            (2, "smooth", 2),
            (2, "restrict", 1),
            (1, "smooth", 2),
            (1, "restrict", 1),
            (0, "solve", 9),
            (1, "prolong", 1),
            (2, "prolong", 1),
        ]
    fields = {
        "displacement": displacement,
        "contact": contact,
        "reaction": np.zeros_like(displacement),
        "status": am.Status.CONVERGED,
        "cycles": 11,
        "work_units": 47.0,
        "residual": 1e-9,
        "error_estimate": 2e-9,
        "rate": 0.2,
        "rtol": 1e-8,
        "history": history,
        "timings": {"setup": 0.01, "cycles": 0.2},
        "path": way,
        "levels": [
            {"level": k, "nodes": n, "contact_nodes": 5, "nonzeros": 100}
            for k, n in enumerate((25, 81, 289))
        ],
        "problem_name": "made up",
        "solver_name": "none",
        "mesh": mesh,
    }
    return am.Result(**(fields | changes))


def same(a: object, b: object) -> bool:
    """Whether two results, or parts of them, hold the same numbers."""
    if isinstance(a, np.ndarray):
        return (
            isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        )
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    if type(a).__module__.startswith("adaptmg.") and hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(
            same(*(vars(one).get(k, getattr(type(one), k, None)) for one in (a, b)))
            for k in a.__dataclass_fields__
        )
    return a is b or a == b
