"""What the numbers of observations and actions are."""

import numpy as np
from numpy.typing import NDArray

from . import _supple


class Named:
    """Whatever sees observations, or gives them, and moves joints."""

    _native: _supple.Environments | _supple.Policy

    @property
    def observation_names(self) -> list[str]:
        """Name and unit of every number of an observation, before it is scaled."""
        return self._native.observation_names()

    @property
    def action_names(self) -> list[str]:
        """Names of the joints, in the order of an action's numbers."""
        return self._native.action_names()

    @property
    def action_offset(self) -> NDArray[np.float64]:
        """Joint targets of an action of zeros [rad], shape (joints,)."""
        return self._native.action_scaling()[0]

    @property
    def action_scale(self) -> NDArray[np.float64]:
        """What a unit of action adds to them [rad], shape (joints,)."""
        return self._native.action_scaling()[1]
