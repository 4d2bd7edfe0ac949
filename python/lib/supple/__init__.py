"""Compliant legged locomotion for Python.

`make_vec` creates training environments, `Policy.load` loads a policy, `run_scenario` plays a disturbance of it, and
`evaluate` measures it, or compares sets, in the experiments of the paper. docs/python.md is the manual.
"""

from ._supple import CONFIGURATIONS, POLICIES, RECORDS, REVISION, __version__
from .environment import STAGES, Curriculum, LocomotionEnv, LocomotionVectorEnv, make, make_vec
from .experiment import Comparison, Experiment, evaluate, experiments, learning_curves
from .policy import Policy, describe
from .scenario import Event, Run, run_scenario, scenarios

__all__ = [
    "CONFIGURATIONS",
    "POLICIES",
    "RECORDS",
    "REVISION",
    "STAGES",
    "Comparison",
    "Curriculum",
    "Event",
    "Experiment",
    "LocomotionEnv",
    "LocomotionVectorEnv",
    "Policy",
    "Run",
    "__version__",
    "describe",
    "evaluate",
    "experiments",
    "learning_curves",
    "make",
    "make_vec",
    "run_scenario",
    "scenarios",
]
