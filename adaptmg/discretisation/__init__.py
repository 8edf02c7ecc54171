"""ContactProblem + mesh -> DiscreteProblem: P1 elements, loads, contact nodes, mortar coupling of bodies."""

from adaptmg.discretisation.contact_nodes import contact_nodes
from adaptmg.discretisation.discretise import discretise
from adaptmg.discretisation.elasticity import stiffness
from adaptmg.discretisation.loads import load_vector
from adaptmg.discretisation.measures import element_strain, full_stress, von_mises
from adaptmg.discretisation.rigid_motions import rigid_motions
from adaptmg.discretisation.supports import fixed_dofs

__all__ = ["contact_nodes", "discretise", "element_strain", "fixed_dofs", "full_stress", "load_vector",
           "rigid_motions", "stiffness", "von_mises"]
