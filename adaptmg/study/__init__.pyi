from .cluster import local_cluster as local_cluster
from .designs import (
    Grid as Grid,
    LatinHypercube as LatinHypercube,
    Points as Points,
    Random as Random,
    Sobol as Sobol,
)
from .study import Study as Study, StudyStatus as StudyStatus
from .tables import as_text as as_text
