from .cluster import local_cluster as local_cluster
from .designs import (
    LatinHypercube as LatinHypercube,
    Random as Random,
    Sobol as Sobol,
)
from .study import Study as Study, StudyStatus as StudyStatus
from .tables import as_text as as_text
