"""One step of the Dormand-Prince 5(4) pair, for whatever is integrated.

Source of the coefficients: Dormand, Prince, J. Comput. Appl. Math. 6 (1980) 19, RK5(4)7M. The last stage of a step is
the first of the next. The sums put the newest stage last: it is the only one the next stage has to wait for.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from sawbench.modeling.compilation import kernel

FRACTIONS = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0])
A21 = 1 / 5
A31, A32 = 3 / 40, 9 / 40
A41, A42, A43 = 44 / 45, -56 / 15, 32 / 9
A51, A52, A53, A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
A61, A62, A63, A64, A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
B1, B3, B4, B5, B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
E1, E3, E4, E5, E6, E7 = 71 / 57600, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40


def step_of(rate: Callable[..., Any], add: Callable[..., Any]) -> Callable[..., Any]:
    """Make the step of one system of equations.

    What is only integrated along (a duration, an energy) is a component of the state that `rate` does not read:
    compiled, its sums at the stages are then never computed.

    Parameters
    ----------
    rate : callable
        (place, stage 0 to 5, y) to the rates of the components of `y`; `place` is handed on to it.
    add : callable
        (y, a, k) to y + a k, component by component.

    Returns
    -------
    callable
        (place, h, y, rates at y) to the state and its rates after a step of `h`, and the local errors of the first two
        components.
    """

    def step(place, h, y, k1):
        k2 = rate(place, 1, add(y, h * A21, k1))
        k3 = rate(place, 2, add(add(y, h * A31, k1), h * A32, k2))
        k4 = rate(place, 3, add(add(add(y, h * A41, k1), h * A42, k2), h * A43, k3))
        k5 = rate(place, 4, add(add(add(add(y, h * A51, k1), h * A52, k2), h * A53, k3), h * A54, k4))
        y6 = add(add(add(add(add(y, h * A61, k1), h * A62, k2), h * A63, k3), h * A64, k4), h * A65, k5)
        k6 = rate(place, 5, y6)
        end = add(add(add(add(add(y, h * B1, k1), h * B3, k3), h * B4, k4), h * B5, k5), h * B6, k6)
        k7 = rate(place, 5, end)
        error_0 = E1 * k1[0] + E3 * k3[0] + E4 * k4[0] + E5 * k5[0] + E6 * k6[0] + E7 * k7[0]
        error_1 = E1 * k1[1] + E3 * k3[1] + E4 * k4[1] + E5 * k5[1] + E6 * k6[1] + E7 * k7[1]
        return end, k7, np.abs(h * error_0), np.abs(h * error_1)

    return step


def compiled_step(rate: Any, add: Any) -> Any:
    """`step_of` two compiled functions, compiled into its callers: those are kept on disk, so it need not be."""
    return kernel(cache=False, forceinline=True)(step_of(rate, add))
