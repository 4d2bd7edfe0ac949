"""Compliant legged locomotion for Python.

`make_vec` has the training environments, `Policy` the policies, `run_scenario` what disturbs them and `evaluate` the
experiments of the paper. docs/python.md tells more.
"""

from ._supple import CONFIGURATIONS, POLICIES, RECORDS, REVISION
from .environment import STAGES, Curriculum, LocomotionEnv, LocomotionVectorEnv, make, make_vec
from .experiment import Experiment, evaluate, experiments
from .policy import Policy, describe
from .scenario import Event, Run, run_scenario, scenarios

__all__ = [
    "CONFIGURATIONS",
    "POLICIES",
    "RECORDS",
    "REVISION",
    "STAGES",
    "Curriculum",
    "Event",
    "Experiment",
    "LocomotionEnv",
    "LocomotionVectorEnv",
    "Policy",
    "Run",
    "describe",
    "evaluate",
    "experiments",
    "make",
    "make_vec",
    "run_scenario",
    "scenarios",
]
