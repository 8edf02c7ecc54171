"""ContactProblem + mesh -> DiscreteProblem: P1 elements, loads, contact nodes, mortar coupling of
bodies."""

from adaptmg.discrete.discretise import discretise
from adaptmg.discrete.elasticity import rigid_motions, stiffness
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.stress import element_strain, full_stress, von_mises
from adaptmg.discrete.supports import fixed_dofs

__all__ = [
    "discretise",
    "element_strain",
    "fixed_dofs",
    "full_stress",
    "load_vector",
    "rigid_motions",
    "stiffness",
    "von_mises",
]


def __dir__() -> list[str]:
    return __all__
