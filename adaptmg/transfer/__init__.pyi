from .contact import (
    injected_gap as injected_gap,
    injected_limit as injected_limit,
    injected_slip as injected_slip,
    largest_gap as largest_gap,
    minmod_slip as minmod_slip,
    smallest_gap as smallest_gap,
    summed_limit as summed_limit,
    Supports as Supports,
    supports as supports,
    surface_interpolation as surface_interpolation,
    with_contact_rows as with_contact_rows,
)
from .galerkin import galerkin_product as galerkin_product, without_fixed as without_fixed
from .interpolation import (
    CLIP as CLIP,
    Interpolation as Interpolation,
    Location as Location,
    mesh_ratio as mesh_ratio,
    PointLocator as PointLocator,
    size_ratio as size_ratio,
    Transfer as Transfer,
)
from .projections import (
    L2 as L2,
    LumpedL2 as LumpedL2,
    PseudoL2 as PseudoL2,
    QuasiInterpolation as QuasiInterpolation,
)
