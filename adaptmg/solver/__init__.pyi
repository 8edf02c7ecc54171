from .certificate import Condition as Condition
from .examine import ContactResult as ContactResult
from .quantities import (
    Resultant as Resultant,
    StressData as StressData,
    StressIntensity as StressIntensity,
    TieForces as TieForces,
)
