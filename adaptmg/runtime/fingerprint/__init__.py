"""What a run depends on, part by part: a stored result is given for the same parts only.

Parts are the code of the run function and of what it calls of the user's own modules, the values it reads (defaults,
closures, globals, attributes of functions), the modules of adaptmg it can reach, and the versions of the packages it
uses. What is seen and what is not, in full: :mod:`adaptmg.runtime.fingerprint.fingerprint`.
"""

from __future__ import annotations

from adaptmg.runtime.fingerprint.fingerprint import Fingerprint, environment, fingerprint, value_parts

__all__ = ["Fingerprint", "environment", "fingerprint", "value_parts"]
