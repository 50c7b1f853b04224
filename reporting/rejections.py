"""Why a fit is not reliable, in words: the likely cause, and how to correct it."""

from __future__ import annotations

import shlex
from typing import Final

from sawbench.bench.processed import ProcessedTrial
from sawbench.bench.units import BATTERY_CURRENT, MOTOR_CURRENT
from sawbench.modeling.results import CuttingFit

# The duty that the currents show is good to the gains of two sensors, 1 % each, and the converter's losses.
_DUTY_TOLERANCE: Final = 0.05


def measured_duty(processed: ProcessedTrial) -> float | None:
    """Duty that the currents show: mean battery current over mean motor current.

    Holds for a converter without losses of its own; None where a current is missing or doubted.
    """
    battery = processed.mean_values.get(BATTERY_CURRENT.name)
    motor = processed.mean_values.get(MOTOR_CURRENT.name)
    if battery is None or not motor or processed.doubts(BATTERY_CURRENT.name, MOTOR_CURRENT.name):
        return None
    return battery / motor


def wrong_duty(processed: ProcessedTrial) -> tuple[str, str] | None:
    """Say that the stated duty is not the one that the currents show, and what to do; None where they agree.

    Parameters
    ----------
    processed : ProcessedTrial
    """
    stated, measured = processed.trial.duty, measured_duty(processed)
    if not stated or measured is None or abs(measured / stated - 1.0) <= _DUTY_TOLERANCE:
        return None
    return (
        f"wrong duty entered: {stated:.4g} is stated, the currents (battery over motor) show {measured:.3g}",
        f"if the duty was {measured:.3g}: `sawbench amend {_file_of(processed)} --duty {measured:.3g}`, which does not"
        " change the recording; otherwise check the two current sensors",
    )


def likely_cause(processed: ProcessedTrial, fit: CuttingFit) -> tuple[str, str]:
    """Name what most likely spoilt a fit, and what to do.

    Parameters
    ----------
    processed : ProcessedTrial
    fit : CuttingFit
        Whose status is not "ok".

    Returns
    -------
    cause, remedy : str
    """
    doubts = processed.doubts(*processed.mean_values)
    if doubts:
        return "; ".join(doubts), "correct the channel or the configuration and import or record the trial again"
    duty = wrong_duty(processed)
    if duty is not None:
        return duty
    remedy = f"see `sawbench report {_file_of(processed)}`"
    if fit.status == "contradicted":
        return (
            "; ".join(fit.notes) or "the plant constants or a sensor gain do not agree with the measurement",
            "check the [plant] of the configuration and the calibration of the sensors; " + remedy,
        )
    return "; ".join(fit.notes), remedy


def _file_of(processed: ProcessedTrial) -> str:
    """Return the recording, as a shell takes it."""
    return shlex.quote(processed.source_path or processed.trial.trial_id)
