"""adaptmg."""
