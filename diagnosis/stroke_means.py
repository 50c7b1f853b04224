"""What a trial without displacement still tells: means over whole strokes, at a stroke rate read from a ripple.

The electrical, supply and converter balances hold for the means over a stroke and need the stroke rate only. The
crank angle stays unknown (NaN), so neither the mechanical nor the cutting equation can be evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from sawbench.bench.processed import CrankAngle, TrackedTrial
from sawbench.bench.recording import Floats, Signal
from sawbench.bench.units import CHANNEL_BY_NAME, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.reduction import CHANNEL_OF_STATE, N_POINTS
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI, State, TrialSetting
from sawbench.processing.binning import time_cell_means
from sawbench.processing.settled import SETTLE_S

_STROKES_A_UNIT = 8
_MIN_UNITS = 2
# Where to look for the stroke rate, as a share of the one that voltage and current ask for.
_SEARCH = (0.7, 1.2)


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeMeans:
    """Means of one trial over units of a few strokes.

    Attributes
    ----------
    edges_s : ndarray, shape (n_units + 1,)
    rate_hz : ndarray, shape (n_units,)
        Stroke rate of each unit.
    means : dict of str to ndarray, shape (n_units,)
        By channel, SI.
    angle : CrankAngle
        Uniform turning at the mean rate, of unknown zero: for what adds up over a trial.
    """

    edges_s: Floats
    rate_hz: Floats
    means: dict[str, Floats]
    angle: CrankAngle

    def state(self, setting: TrialSetting) -> State:
        """Running state of shape (n_units, n_points) that is flat over the turn; its angle is NaN."""
        shape = (len(self.rate_hz), N_POINTS)

        def flat(values: Floats) -> Floats:
            return np.repeat(np.asarray(values, dtype=np.float64)[:, None], N_POINTS, axis=1)

        by_place = {CHANNEL_OF_STATE[name]: flat(values) for name, values in self.means.items()}
        voltage = by_place.get("battery_voltage_v")
        nothing = np.zeros((shape[0], 1))
        return State(
            kind="running",
            setting=setting,
            angle_rad=np.full(shape, np.nan),
            speed_rad_s=flat(TWO_PI * self.rate_hz),
            acceleration_rad_s2=np.zeros(shape),
            current_a=by_place.get("current_a"),
            current_rate_a_s=np.zeros(shape) if "current_a" in by_place else None,
            force_n=None,
            force_rate_n_s=None,
            battery_voltage_v=voltage,
            battery_current_a=by_place.get("battery_current_a"),
            motor_voltage_v=np.full(shape, np.nan) if voltage is None else setting.duty * voltage,
            time_s=(0.5 * (self.edges_s[1:] + self.edges_s[:-1]))[:, None],
            cut_distance_m=nothing,
            charge_used_as=nothing,
            n_strokes=self.rate_hz * np.diff(self.edges_s),
        )


def stroke_means(trial: TrackedTrial, baseline: Baseline) -> StrokeMeans | None:
    """Average a trial without displacement over whole strokes.

    Parameters
    ----------
    trial : TrackedTrial
    baseline : Baseline
        Its nominal constants say where the stroke rate must lie.

    Returns
    -------
    StrokeMeans or None
        None where no channel shows a clear stroke rate. Bias: the rate is wrong where another line lies within
        0.7 to 1.2 of the expected one and is stronger.
    """
    names = (MOTOR_CURRENT.name,) if trial.trial.is_idle else (FORCE.name, MOTOR_CURRENT.name)
    for name in names:
        signal = trial.channels.get(name)
        if signal is None or signal.duration_s < 2.0 * SETTLE_S:
            continue
        found = _rates(signal, _expected_rate_hz(trial, baseline))
        if found is not None:
            edges_s, rate_hz = found
            names = [n for n in CHANNEL_OF_STATE if _covers(trial, n, edges_s)]
            return StrokeMeans(
                edges_s=edges_s,
                rate_hz=rate_hz,
                means={n: _means(trial.channels[n], edges_s) for n in names},
                angle=_uniform(signal, edges_s, rate_hz),
            )  # fmt: skip
    return None


def _expected_rate_hz(trial: TrackedTrial, baseline: Baseline) -> float:
    """Rate at which voltage less resistive drop is the back-EMF."""
    plant = baseline.plant
    voltage, current = trial.channels.get("battery_voltage_v"), trial.channels.get(MOTOR_CURRENT.name)
    nominal = 18.0 if baseline.battery is None else baseline.battery.nominal_voltage_v
    battery_v = nominal if voltage is None else float(np.median(voltage.values))
    drop_v = 0.0 if current is None else plant.resistance_ohm.nominal * float(np.median(current.values))
    emf_v = max((trial.trial.duty or 0.0) * battery_v - drop_v, 0.1)
    return emf_v / (plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * TWO_PI)


def _rates(signal: Signal, expected_hz: float) -> tuple[Floats, Floats] | None:
    """Edges of units of about `_STROKES_A_UNIT` strokes and the rate in each, from the phase of the strongest line."""
    start_s, end_s = float(signal.time_s[0]) + SETTLE_S, float(signal.time_s[-1])
    step_s = 1.0 / max(signal.rate_hz, 20.0 * expected_hz)
    time_s = np.arange(start_s, end_s, step_s)
    wave = np.interp(time_s, signal.time_s, signal.values)
    window = np.hanning(len(wave))
    n = 8 * len(wave)
    spectrum = np.abs(np.fft.rfft((wave - wave.mean()) * window, n))
    frequency = np.fft.rfftfreq(n, step_s)
    best = (0.0, 0.0, 1)
    for order in (1, 2):
        near = (frequency > order * _SEARCH[0] * expected_hz) & (frequency < order * _SEARCH[1] * expected_hz)
        around = (frequency > 0.3 * expected_hz) & (frequency < 3.0 * expected_hz)
        floor = float(np.median(spectrum[around])) if around.any() else 0.0
        if near.any() and floor > 0.0:
            peak = int(np.argmax(spectrum[near]))
            height = float(spectrum[near][peak]) / floor
            best = max(best, (height, float(frequency[near][peak]), order))
    height, line_hz, order = best
    n_units = int((end_s - start_s) * line_hz / order / _STROKES_A_UNIT)
    if height < SETTINGS.reading.clear_line or n_units < _MIN_UNITS:
        return None
    edges_s = start_s + np.arange(n_units + 1) * _STROKES_A_UNIT * order / line_hz
    turning = (wave - wave.mean()) * np.exp(-1j * TWO_PI * line_hz * time_s)
    # The phase at each edge from the strokes around it; the rate of a unit from the phases at its ends.
    half_s = 0.5 * _STROKES_A_UNIT * order / line_hz
    phase = np.unwrap([float(np.angle(turning[np.abs(time_s - edge) < half_s].sum())) for edge in edges_s])
    # Half the strokes are missing at the two outer edges: their phase is that of a quarter unit inwards.
    reach = np.concatenate([[0.5 * half_s], np.zeros(n_units - 1), [-0.5 * half_s]])
    slope = np.diff(phase) / np.diff(edges_s + reach)
    return edges_s, (line_hz + slope / TWO_PI) / order


def _covers(trial: TrackedTrial, name: str, edges_s: Floats) -> bool:
    """Whether a channel holds samples in every unit; the force has no use without the angle."""
    signal = trial.channels.get(name)
    if signal is None or name == FORCE.name:
        return False
    cells = [np.searchsorted(signal.time_s, edge) for edge in edges_s]
    return all(b - a > N_POINTS // 16 for a, b in pairwise(cells))


def _means(signal: Signal, edges_s: Floats) -> Floats:
    return CHANNEL_BY_NAME[signal.channel].si_factor * time_cell_means(signal.time_s, signal.values, edges_s)


def _uniform(signal: Signal, edges_s: Floats, rate_hz: Floats) -> CrankAngle:
    time_s = np.concatenate([[signal.time_s[0]], edges_s[1:-1], [signal.time_s[-1]]])
    turned = np.concatenate([[0.0], np.cumsum(TWO_PI * rate_hz * np.diff(time_s))])
    return CrankAngle(
        time_s=time_s,
        angle_rad=turned,
        speed_rad_s=np.concatenate([TWO_PI * rate_hz, [TWO_PI * rate_hz[-1]]]),
        angle_std_rad=np.full(len(time_s), np.pi),
        radius_m=0.0,
        source=signal.channel,
        is_absolute=False,
    )
