"""Transfers between meshes, nested or not: point location, prolongations, transport of contact
data."""

from adaptmg.geometry.location import Location
from adaptmg.transfer.contact import (
    Supports,
    injected_gap,
    injected_limit,
    injected_slip,
    largest_gap,
    minmod_slip,
    smallest_gap,
    summed_limit,
    supports,
    surface_interpolation,
    with_contact_rows,
)
from adaptmg.transfer.galerkin import galerkin_product, without_fixed
from adaptmg.transfer.interpolation import (
    CLIP,
    Interpolation,
    PointLocator,
    Transfer,
    mesh_ratio,
    size_ratio,
)
from adaptmg.transfer.projections import L2, LumpedL2, PseudoL2, QuasiInterpolation

__all__ = [
    "CLIP",
    "L2",
    "Interpolation",
    "Location",
    "LumpedL2",
    "PointLocator",
    "PseudoL2",
    "QuasiInterpolation",
    "Supports",
    "Transfer",
    "galerkin_product",
    "injected_gap",
    "injected_limit",
    "injected_slip",
    "largest_gap",
    "mesh_ratio",
    "minmod_slip",
    "size_ratio",
    "smallest_gap",
    "summed_limit",
    "supports",
    "surface_interpolation",
    "with_contact_rows",
    "without_fixed",
]


def __dir__() -> list[str]:
    return __all__
