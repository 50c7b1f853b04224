"""One direction in which the baseline may be mistuned, and one channel that may be read wrongly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import TransferFunction
from sawbench.modeling.residuals import Baseline, Equation, Signature
from sawbench.modeling.state import State

# (model of the plant: here a Baseline, State) -> Signature
SignatureFunction = Callable[[Any, State], Signature]


@dataclass(frozen=True, kw_only=True, slots=True)
class Nuisance:
    """One direction in which the baseline may be mistuned.

    Attributes
    ----------
    name : str
        Name of the `[plant]` or `[battery]` parameter, or of the sensor property.
    std : float
        Prior standard uncertainty, in the unit of `nominal`.
    signature : callable
        (baseline, state) -> change of the residuals for one unit.
    nominal : float
        0 for offsets.
    is_plant : bool
        A number of the configuration (reported as a parameter shift), not of a sensor.
    is_effect : bool
        Its error is an effect of the catalogue, and weighed as that: it is not re-tuned beyond its uncertainty.
    is_zero : bool
        Its error is that of a sensor's zero.
    is_curve : bool
        It is a shape of the battery's open-circuit curve: known as far as the charge was used.
    is_shared : bool
        All trials have it, although it is listed with what differs between them.
    transfer : callable, optional
        Of a filter of the force: the signature is what this makes of the expected force, less that; see
        `common_filter.filtered`.
    """

    name: str
    std: float
    signature: SignatureFunction
    nominal: float = 0.0
    is_plant: bool = False
    is_effect: bool = False
    is_zero: bool = False
    is_curve: bool = False
    is_shared: bool = False
    transfer: TransferFunction | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """One channel, as a state holds it, and what its errors do.

    Attributes
    ----------
    attribute : str
        Of `State`.
    signature : callable
        (baseline, state) -> change of the residuals for one unit more in the reading.
    of_rate : callable, optional
        The same for one unit a second more in the rate of the reading, where an equation holds that.
    """

    attribute: str
    signature: SignatureFunction
    of_rate: SignatureFunction | None = None

    def power(self, baseline: Baseline, state: State, order: Mapping[Equation, Floats]) -> dict[Equation, Floats]:
        """Mean square of what one unit of error at some harmonics makes of the residuals, by equation.

        Parameters
        ----------
        baseline : Baseline
        state : State
        order : mapping of str to ndarray
            Of the harmonics, by equation: an equation with the rate of the reading has the more of it the faster it is.

        Returns
        -------
        dict of str to ndarray
            Shapes of `order`; without equations that the reading does not reach.
        """
        moved = self.signature(baseline, state)
        found = {name: float(np.mean(moved[name] ** 2)) * np.ones_like(order[name]) for name in moved if name in order}
        for name, by_rate in self.of_rate(baseline, state).items() if self.of_rate else ():
            if name in order:
                faster_rad_s = order[name] * float(state.speed_rad_s.mean())
                found[name] = found.get(name, 0.0) + faster_rad_s**2 * float(np.mean(by_rate**2))
        return found

    def of(self, state: State) -> Floats | None:
        """Values of a state, shape (n_units, n_points); None where it has none."""
        return getattr(state, self.attribute)
