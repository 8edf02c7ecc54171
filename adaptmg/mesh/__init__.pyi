from .arrays import MeshArrays as MeshArrays
from .arrays import need_mesh as need_mesh, Surface as Surface
from .bisection import bisect as bisect, refine_near as refine_near
from .projection import onto_domain as onto_domain
from .grading import graded as graded, sized as sized
from .read import as_mesh as as_mesh, from_file as from_file
from .sizes import SizeNear as SizeNear
from .slits import split as split
from .soundness import (
    check_mesh as check_mesh,
    MeshQuality as MeshQuality,
    quality as quality,
)
from .step import step_table as step_table, touching as touching
from .lattices import merged as merged, structured as structured
