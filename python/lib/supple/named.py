"""Names, units and scales of observations and actions."""

import numpy as np
from numpy.typing import NDArray

from . import _supple


class Named:
    """An environment or a policy, whose observations and actions are described here."""

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
        """Joint targets at action zero [rad], shape (12,)."""
        return self._native.action_scaling()[0]

    @property
    def action_scale(self) -> NDArray[np.float64]:
        """Change of the joint target per unit of action [rad], shape (12,)."""
        return self._native.action_scaling()[1]
