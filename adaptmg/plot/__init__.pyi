from .contact_surfaces import contact as contact, load_history as load_history
from .convergence import history as history, path as path
from .deformed import deformation as deformation
from .meshes import adaptation as adaptation, grids as grids, mesh as mesh
from .posed_problem import problem as problem
