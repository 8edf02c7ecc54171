"""Assembly: several bodies as one domain. Lengths in m; boundaries are named "body.edge"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from adaptmg.problem import checks
from adaptmg.problem.domains.straight import Domain

__all__ = ["Assembly"]


@dataclass(frozen=True, kw_only=True)
class Assembly(Domain):
    """Bodies that share no nodes; they may touch, or even overlap (a ring of bolts in an axisymmetric model does).

    Parameters
    ----------
    parts : mapping of str to Domain
        The geometry of each body by its name, without "."; all of the same dimension.

    Examples
    --------
    >>> from adaptmg.problem import Rectangle
    >>> Assembly(parts={"upper": Rectangle(width=1.0, height=1.0)}).boundaries
    ('upper.bottom', 'upper.right', 'upper.top', 'upper.left')
    """

    parts: Mapping[str, Domain]

    def __post_init__(self) -> None:
        if not isinstance(self.parts, Mapping):
            raise TypeError(f"parts must map body names to domains, got {checks.described(self.parts)}")
        parts = dict(self.parts)
        if not parts:
            raise ValueError("parts is empty: an assembly needs at least one body")
        for name, part in parts.items():
            checks.boundary_name("the name of a body in parts", name)
            if "." in name:
                raise ValueError(f"the name of a body must not contain '.', got {name!r}: boundaries are 'body.edge'")
            if not isinstance(part, Domain):
                raise TypeError(f"parts[{name!r}] must be a Domain (Rectangle, Polygon, Outline, Box, ...), "
                                f"got {checks.described(part)}")
            if part.bodies is None or len(part.bodies) != 1 or part.boundaries is None or isinstance(part, Assembly):
                raise ValueError(f"parts[{name!r}] must be one body with known boundaries; name the bodies of "
                                 f"{type(part).__name__} one by one")
        dims = {name: part.dim for name, part in parts.items()}
        if len(set(dims.values())) > 1:
            raise ValueError(f"all parts must have the same dimension, got {dims}")
        object.__setattr__(self, "parts", parts)

    def __hash__(self) -> int:
        return hash(tuple(self.parts.items()))

    @property
    def dim(self) -> int:
        """Space dimension."""
        return next(iter(self.parts.values())).dim

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies, in order."""
        return tuple(self.parts)

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The distinct boundary names "body.edge", body by body."""
        return tuple(dict.fromkeys(f"{body}.{edge}" for body, part in self.parts.items() for edge in part.boundaries))

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (dim,), m."""
        return np.min([part.lower for part in self.parts.values()], axis=0)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (dim,), m."""
        return np.max([part.upper for part in self.parts.values()], axis=0)
