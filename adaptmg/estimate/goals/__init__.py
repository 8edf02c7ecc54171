"""Goals: quantities of interest, their dual fields, and dual-weighted residuals on edge bubbles."""

from __future__ import annotations

from adaptmg.estimate.goals.contact_quantities import ContactForce, Opening
from adaptmg.estimate.goals.displacement import Displacement, MeanDisplacement
from adaptmg.estimate.goals.goal import Goal
from adaptmg.estimate.goals.goal_estimate import GoalEstimate

__all__ = ["ContactForce", "Displacement", "Goal", "GoalEstimate", "MeanDisplacement", "Opening"]
