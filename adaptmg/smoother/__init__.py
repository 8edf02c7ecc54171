"""The projected block Gauss-Seidel smoother: numba kernels on arrays, and one thin wrapper."""

from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.smoother.system import (
    OPEN,
    SLIP,
    STICK,
    ContactState,
    LocalProblem,
    LocalSystem,
    NodalContact,
    local_system,
)

__all__ = [
    "OPEN",
    "SLIP",
    "STICK",
    "ContactState",
    "LocalProblem",
    "LocalSystem",
    "NodalContact",
    "ProjectedGaussSeidel",
    "Smoother",
    "local_system",
]


def __dir__() -> list[str]:
    return __all__
