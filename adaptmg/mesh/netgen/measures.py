"""measures: areas or volumes of the bodies of a domain before it is meshed, and the lengths of plane boundaries."""

from __future__ import annotations

from adaptmg.mesh.netgen.grading import check_domain
from adaptmg.mesh.netgen.outline import plane_measures
from adaptmg.mesh.netgen.solids import scaled_shape
from adaptmg.mesh.netgen.step import step_shapes
from adaptmg.problem.domains import Assembly, Domain, StepFile

__all__ = ["measures"]


def measures(domain: Domain) -> tuple[list[float], dict[str, float]]:
    """Area (m^2) or volume (m^3) of each body; of plane domains also the length (m) of each boundary by its name."""
    check_domain(domain)
    if isinstance(domain, Assembly):
        found = {body: measures(part) for body, part in domain.parts.items()}
        return ([volume for volumes, _ in found.values() for volume in volumes],
                {f"{body}.{name}": length for body, (_, lengths) in found.items() for name, length in lengths.items()})
    if domain.dim == 2:
        area, lengths = plane_measures(domain)
        return [area], lengths
    shapes = step_shapes(domain).values() if isinstance(domain, StepFile) else [scaled_shape(domain)]
    return [shape.mass * scale**3 for shape, _, _, scale in shapes], {}
