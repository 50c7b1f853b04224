"""What a fitted battery adds to a runtime: its own uncertainty, and a word where it is used outside its range."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from sawbench.bench.config import BatteryConfig, BatteryRange
from sawbench.modeling.results import RuntimePrediction

BATTERY_FIT: Final = "battery_fit"
# As near to a fitted range as that still counts as inside: share of a current, K, cycles, state of charge.
_NEAR_SHARE, _NEAR_K, _NEAR_CYCLES, _NEAR_SOC = 0.05, 3.0, 10.0, 0.01


@dataclass(frozen=True, kw_only=True, slots=True)
class BatteryUse:
    """Under what conditions the battery is to be discharged; None where nobody said.

    Attributes
    ----------
    temperature_c : float or None
        Of the surroundings.
    cycle : float or None
        Charges and discharges that the battery has been through.
    """

    temperature_c: float | None = None
    cycle: float | None = None


def with_battery_fit(
    prediction: RuntimePrediction, battery: BatteryConfig, use: BatteryUse | None = None
) -> RuntimePrediction:
    """Widen a runtime by the uncertainty of the battery's fit, and warn where that does not hold.

    Parameters
    ----------
    prediction : RuntimePrediction
    battery : BatteryConfig
        Without `fitted` the prediction stays as it is.
    use : BatteryUse, optional

    Returns
    -------
    RuntimePrediction
        `battery_fit` is among its contributions. The interval is that of the withheld discharges: it does not cover
        what lies outside the fitted range, which the notes name.
    """
    fitted = battery.fitted
    if fitted is None or prediction.status != "ok":
        return prediction
    own_s = fitted.runtime_rel_std * prediction.runtime_s
    return replace(
        prediction,
        std_s=math.hypot(prediction.std_s, own_s),
        contributions_s={**prediction.contributions_s, BATTERY_FIT: own_s},
        notes=(*prediction.notes, *outside_range(prediction.mean_battery_current_a, battery, use)),
        battery_basis=basis_of(fitted),
    )


def basis_of(fitted: BatteryRange) -> str:
    """Say in one line what a battery was fitted to.

    Examples
    --------
    >>> basis_of(BatteryRange(n_discharges=4, runtime_rel_std=0.04, current_a=(0.5, 10.0), temperature_c=(24.5, 24.6)))
    'battery fitted to 4 discharges at 0.5 to 10 A, 24.5 to 24.6 degC; u(runtime) 4 %'
    """
    parts = [f"{_span(fitted.current_a)} A"]
    parts += [f"{_span(fitted.temperature_c)} degC"] if fitted.temperature_c is not None else []
    parts += [f"cycle {_span(fitted.cycle)}"] if fitted.cycle is not None else []
    share = f"{100.0 * fitted.runtime_rel_std:.2g} %"
    return f"battery fitted to {fitted.n_discharges} discharges at {', '.join(parts)}; u(runtime) {share}"


def outside_range(
    mean_battery_current_a: float, battery: BatteryConfig, use: BatteryUse | None = None
) -> Iterator[str]:
    """Say in words where a discharge lies outside of what its battery was fitted to.

    Parameters
    ----------
    mean_battery_current_a : float
        Of the discharge.
    battery : BatteryConfig
        Without `fitted` there is nothing to say.
    use : BatteryUse, optional
    """
    fitted, use = battery.fitted, use or BatteryUse()
    if fitted is None:
        return
    checks = (
        ("mean battery current", mean_battery_current_a, " A", fitted.current_a, _NEAR_SHARE * mean_battery_current_a),
        ("temperature", use.temperature_c, " degC", fitted.temperature_c, _NEAR_K),
        ("cycle", use.cycle, "", fitted.cycle, _NEAR_CYCLES),
        ("cut-off state of charge", battery.cutoff_soc, "", fitted.soc, _NEAR_SOC),
    )
    for name, value, unit, limits, near in checks:
        if value is None:
            continue
        if limits is None:
            yield f"{name} {value:.3g}{unit}: the battery fit states no range, so its validity is unknown"
        elif not limits[0] - near <= value <= limits[1] + near:
            yield (
                f"{name} {value:.3g}{unit} lies outside the {_span(limits)}{unit} of the battery fit: the "
                "runtime is extrapolated, which its interval does not cover"
            )


def _span(limits: tuple[float, float]) -> str:
    low, high = (f"{limit:.3g}" for limit in limits)
    return low if low == high else f"{low} to {high}"
