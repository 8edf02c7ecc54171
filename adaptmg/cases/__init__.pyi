from .blocks import (
    incline as incline,
    leaning_strut as leaning_strut,
    two_block_patch as two_block_patch,
)
from .bolts import bolted_junction as bolted_junction, Flanges as Flanges
from .catalogue import (
    Case as Case,
    CASES as CASES,
    FROM_PYTHON as FROM_PYTHON,
    get as get,
)
from .closed_forms import (
    cattaneo as cattaneo,
    flat_punch as flat_punch,
    hertz_cylinder as hertz_cylinder,
    hertz_sphere as hertz_sphere,
    HertzContact as HertzContact,
    PartialSlip as PartialSlip,
)
from .transition import (
    coulomb_transition as coulomb_transition,
    TransitionField as TransitionField,
)
from .impact import impact_bar as impact_bar
from .paper import (
    curved_obstacle as curved_obstacle,
    dovetail as dovetail,
    greco_bar as greco_bar,
    greco_block as greco_block,
    upset_block as upset_block,
)
from .plastic_bodies import (
    hill_cylinder as hill_cylinder,
    pierced_plate as pierced_plate,
    prandtl_punch as prandtl_punch,
    upset_billet as upset_billet,
)
from .scalar import (
    elastic_plastic_torsion as elastic_plastic_torsion,
    obstacle_problem as obstacle_problem,
)
