from .load_path import StepNotConverged as StepNotConverged
