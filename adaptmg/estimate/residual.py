r"""Residual: an estimate of the energy error from what the discrete solution leaves of the equations.

.. math:: \eta_T^2 = \frac1E \Big\{ h_T^2 \|f + \mathrm{div}\,\sigma_h\|^2 + \frac12 \sum_{\mathrm{interior}} h_F
   \|[\sigma_h n]\|^2 + \sum_{\mathrm{boundary}} h_F \|g + t_h - \sigma_h n\|^2 \Big\}
   + \int p_h (g_0 - u_n) + \int (\mu p_h |d_t| + t_h \cdot d_t)

:math:`L^2` norms over element or facet, E Young's modulus of the element, so that all terms are energies;
:math:`h_F = |F|`, in space :math:`\sqrt{2|F|}`; :math:`t_h` the contact traction on slave and master, nodal forces over
lumped masses. The last two terms are on slaves alone. Measured, the estimate is 2 to 5 times the error, by problem and
pattern of the mesh (the GRECO bar: 2.7 with alternating diagonals and on bisected meshes, 3.0 to 3.2 on Netgen
meshes, 3.3 to 3.7 with all diagonals alike), and nearly constant on the meshes of one family; it is not proven to bound
the error. Where body forces, or the hoop stress of smooth axisymmetric fields, rule the error it is 5.7 to 8.8 times
the error (Lame's tube, a column under its own weight; Poisson's ratio .1 to .4): the first term is two thirds of its
square there. Where a contact zone between curved bodies has one or two nodes it is up to 30 times the error, nearly all
of it complementarity, until meshes resolve the zone.
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.fields.posed import posed
from adaptmg.estimate.terms.boundary import boundary_squares
from adaptmg.estimate.terms.contact import condition_squares
from adaptmg.estimate.terms.jumps import jump_squares
from adaptmg.estimate.terms.volume import volume_squares
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.result import Result

__all__ = ["Residual"]


@dataclass(frozen=True)
class Residual:
    """The residual indicator; it has no parameters."""

    def indicate(self, hierarchy: Hierarchy, result: Result) -> Estimate:
        """Estimate the error on the finest mesh.

        Parameters
        ----------
        hierarchy : Hierarchy
            Of a ContactProblem, whose loads are those of the result.
        result : Result
            Of :func:`adaptmg.solve` on it.

        Returns
        -------
        Estimate
            Terms: "element residual", "jumps inside", "traction on boundaries", "traction in contact",
            "complementarity", "friction"; squares of energies, N m (plane: per metre of thickness).

        Raises
        ------
        TypeError, ValueError
            As of :func:`adaptmg.estimate.fields.posed.posed`: without problem, mesh or materials, of a result of
            another mesh, or one that is not finite.
        """
        this = posed(hierarchy, result)
        volume = volume_squares(this.stress, this.problem.loads, this.young)
        free, touching = boundary_squares(this)
        complementarity, friction = condition_squares(this)
        parts = {"element residual": volume, "jumps inside": jump_squares(this.stress, this.neighbours.across,
                                                                          this.young),
                 "traction on boundaries": free, "traction in contact": touching, "complementarity": complementarity,
                 "friction": friction}
        parts = {name: part for name, part in parts.items() if part is not None}
        return Estimate(squares=sum(parts.values()), norm=this.norm, indicator="residuals",
                        terms={name: part.sum() for name, part in parts.items()})
