from .bodies import deformation as deformation, grids as grids, mesh as mesh
from .contact_surfaces import contact as contact, load_history as load_history
from .convergence import adaptation as adaptation, history as history, path as path
from .posed_problem import problem as problem
