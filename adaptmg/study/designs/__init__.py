"""Which points a study runs."""

from adaptmg.study.designs.design import Design, Grid, Points, Zip, as_design, check_length
from adaptmg.study.designs.samples import LatinHypercube, Random, Repeated, Sobol

__all__ = ["Design", "Grid", "LatinHypercube", "Points", "Random", "Repeated", "Sobol", "Zip", "as_design",
           "check_length"]
