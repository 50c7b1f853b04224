"""Diagnosis of a saw, whatever its mechanism: noise floors, uncertainties, harmonics and next trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.bandwidth import bandwidth_nuisances
from sawbench.diagnosis.inference.beyond.table import BEYOND_CATALOGUE
from sawbench.diagnosis.inference.clocks import clock_nuisances
from sawbench.diagnosis.inference.common_filter import common_filter_nuisances
from sawbench.diagnosis.inference.crosstalk import crosstalk_nuisances
from sawbench.diagnosis.inference.features import (
    HARMONICS,
    N_BLOCKS,
    START_UP_EDGES_S,
    Layout,
    orders,
    times_over_angles,
)
from sawbench.diagnosis.inference.force_filter import force_filter_nuisances
from sawbench.diagnosis.inference.nuisance import Nuisance, Reading
from sawbench.diagnosis.inference.nuisances import READINGS, force_offset, further_batteries, nuisances_of, of_known
from sawbench.diagnosis.inference.plunger_drive import plunger_drive_nuisances
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.vibration import vibration_nuisances
from sawbench.diagnosis.inference.zero_wander import ZeroWander, zero_readings, zero_wander
from sawbench.diagnosis.plants.plant import EquationForm
from sawbench.diagnosis.smooth_state import smooth_state
from sawbench.modeling.effects.effect import Effect, Place
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.load import OAK
from sawbench.modeling.machines.machine import Machine
from sawbench.modeling.machines.table import saw_of
from sawbench.modeling.parts.linear import coefficient
from sawbench.modeling.residuals import UNITS, Baseline, Equation, Signature, bare_residuals
from sawbench.modeling.state import State, angle_derivative

_PLACES: Final[dict[Equation, tuple[Place, str, str]]] = {
    "electrical": ("electrical", "motor_current_a", "A"),
    "mechanical": ("mechanical", "motor_current_a", "A"),
    "cutting": ("cutting", "force_n", "N"),
    "supply": ("supply", "battery_voltage_v", "V"),
    "converter": ("supply", "battery_current_a", "A"),
}
_CHANNELS: Final[dict[Equation, tuple[str, ...]]] = {
    "electrical": ("current_a",),
    "mechanical": ("current_a", "force_n"),
    "cutting": ("force_n",),
    "supply": ("battery_voltage_v", "battery_current_a"),
    "converter": ("battery_current_a", "current_a"),
}
# The motor's voltage is that of the battery: in a start-up it sags.
_START_UP_CHANNELS: Final = {**_CHANNELS, "electrical": ("current_a", "battery_voltage_v")}
# Floors above the others: nothing is compared there.
_UNRESOLVED: Final = 1e4
# What goes with the speed, with its square and not at all is told apart by three speeds.
_LEAST_DUTIES: Final = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Jigsaw:
    """A saw as a plant; see `diagnosis.plants.plant.Plant`."""

    baseline: Baseline
    scale_rel_std = 0.0
    expected_rest = 0.0
    beyond_catalogue: tuple[Effect, ...] = BEYOND_CATALOGUE

    @property
    def machine(self) -> Machine:
        """What it is made of."""
        return saw_of(self.baseline.plant, self.baseline.battery)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Those whose parts it has, but for the known ones."""
        known = {one.effect.name for one in self.known}
        return tuple(e for e in self.machine.effects(self.baseline) if e.name not in known)

    @property
    def known(self) -> tuple[KnownEffect, ...]:
        """Those that the model holds."""
        return self.baseline.known

    @property
    def turns_a_cycle(self) -> float:
        """Of the motor, by its gear."""
        return self.baseline.gear

    def with_known(self, known: Sequence[KnownEffect]) -> Jigsaw:
        """See `Plant.with_known`."""
        return replace(self, baseline=replace(self.baseline, known=tuple(known)))

    @property
    def model(self) -> Baseline:
        """Numbers of the baseline."""
        return self.baseline

    @property
    def equations(self) -> Mapping[Equation, EquationForm]:
        """Electrical, mechanical, cutting, supply and converter balance."""
        torque_constant = self.baseline.plant.torque_constant_n_m_per_a.nominal
        # What the voltages of the motor leave is no channel's misprediction: speed and current are both measured.
        factors = {"electrical": None, "mechanical": 1.0 / torque_constant}
        return {
            equation: EquationForm(
                unit=UNITS[equation],
                place=place,
                channel=channel,
                channel_unit=unit,
                to_channel=factors.get(equation, 1.0),
                n_harmonics=HARMONICS[equation],
            )
            for equation, (place, channel, unit) in _PLACES.items()
        }

    def residuals(self, state: State) -> Signature:
        """See `modeling.residuals.bare_residuals`."""
        return bare_residuals(self.baseline, state)

    def smooth(self, state: State, blocks: Floats) -> State:
        """See `diagnosis.smooth_state`."""
        return smooth_state(state, blocks, mechanism=self.baseline.mechanism)

    def model_error(self, layout: Layout, state: State) -> Floats:
        """Covariance of what no repetition shows, shape (layout.size, layout.size): a floor at each harmonic."""
        floor, sensors = np.empty(layout.size), SETTINGS.sensors
        carries = self._carries()
        for equation, part in layout.slices.items():
            least, growth = (carries[equation] * one for one in sensors.floor[equation])
            mean_v = sensors.mean_voltage_share.get(equation, 0.0) * self.baseline.load.battery_v
            if state.kind == "start_up":
                middle_s = 0.5 * (np.array(START_UP_EDGES_S[1:]) + np.array(START_UP_EDGES_S[:-1]))
                at_first = carries[equation] * sensors.start_up_floor[equation]
                floor[part] = np.hypot(2.0 * least + at_first / (1.0 + middle_s / sensors.start_up_decay_s), mean_v)
                resolved_s = max(state.resolved_s.get(channel, 0.0) for channel in _START_UP_CHANNELS[equation])
                floor[part] *= np.where(np.diff(START_UP_EDGES_S) < resolved_s, _UNRESOLVED, 1.0)
            else:
                order = orders((part.stop - part.start - 1) // 2)
                floor[part] = np.hypot(least, growth * order ** (2.0 if equation == "mechanical" else 1.0))
                floor[part.start] = max(floor[part.start], mean_v)
                if equation in ("electrical", "mechanical"):
                    floor[part] = np.hypot(floor[part], self._ripple_error(equation, order, state))
                resolved = min(state.resolved_orders.get(channel, np.inf) for channel in _CHANNELS[equation])
                floor[part] *= np.where(order > resolved, _UNRESOLVED, 1.0)
        of_features = np.diag(floor**2 + self._bend_of_sensors(layout, state))
        return of_features + self._stepped_speed(layout, state) + self._scattered_speed(layout, state)

    def _carries(self) -> dict[str, float]:
        """Load of the saw in the unit of each equation, over that of the paper's saw: what sensors leave is no less."""
        load = self.baseline.load
        ratios = {
            "electrical": load.battery_v / OAK.battery_v, "supply": load.battery_v / OAK.battery_v,
            "converter": load.battery_a / OAK.battery_a, "mechanical": load.torque_n_m / OAK.torque_n_m,
            "cutting": load.force_n / OAK.force_n,
        }  # fmt: skip
        return {equation: max(ratio, 1.0) for equation, ratio in ratios.items()}

    def _bend_of_sensors(self, layout: Layout, state: State) -> Floats:
        """Variance of every feature by characteristics that are straight to a share of the range in use."""
        found, sensors = np.zeros(layout.size), SETTINGS.sensors
        for reading in READINGS.values():
            values = reading.of(state)
            if values is None:
                continue
            bent = sensors.linearity_share * float(np.ptp(values.mean(axis=0)))
            for equation, power in reading.power(self.baseline, state, layout.orders).items():
                smooth = 1.0 / (1.0 + (layout.orders[equation] / sensors.linearity_harmonic) ** 2)
                found[layout.slices[equation]] += bent**2 * power * smooth**2
        return found

    def _stepped_speed(self, layout: Layout, state: State) -> Floats:
        """Covariance by a cutting speed that is measured in coarse steps, shape (layout.size, layout.size).

        The steps lie at the same angles in all strokes: averaging the blocks of a trial must not make it more certain.
        """
        if "cutting" not in layout.equations or not len(state.stroke_std_m):
            return np.zeros((layout.size, layout.size))
        speed_m_s = float(state.speed_rad_s.mean()) * angle_derivative(np.diag(state.stroke_std_m))
        return self._by_cutting_speed(layout, state, speed_m_s)

    def _scattered_speed(self, layout: Layout, state: State) -> Floats:
        """Covariance by harmonics of the blade's velocity that are measured, shape (layout.size, layout.size).

        Of one trial in twenty chance shows a harmonic that is none, and at many samples a stroke the force is certain
        enough to contradict it. One mean is found for a trial: averaging its blocks must not make it more certain.
        """
        nothing = np.zeros((layout.size, layout.size))
        if "cutting" not in layout.equations or state.kind != "running":
            return nothing
        n_units = len(state.speed_rad_s)
        std_m_s = self.smooth(state, np.full((1, n_units), 1.0 / n_units)).excess_std_m_s
        order = np.flatnonzero(std_m_s) + 1
        if not len(order):
            return nothing
        angle = np.outer(order, state.angle_rad[0])
        speed_m_s = np.concatenate([np.cos(angle), np.sin(angle)]) * np.tile(std_m_s[order - 1], 2)[:, None]
        return self._by_cutting_speed(layout, state, speed_m_s)

    def _by_cutting_speed(self, layout: Layout, state: State, speed_m_s: Floats) -> Floats:
        """Covariance by independent errors of the blade's velocity, shape (n, n_points), shared by a trial's blocks."""
        is_cutting = self.baseline.cutting_speed(state).mean(axis=0) > 0.0
        force_n = state.k_guess_n_s_per_m * speed_m_s * is_cutting
        moved = layout.place(
            {"cutting": force_n}, np.broadcast_to(times_over_angles(state).mean(axis=0), force_n.shape)
        )
        return N_BLOCKS * moved.T @ moved

    def _ripple_error(self, equation: Equation, order: Floats, state: State) -> Floats:
        """What an uncertain wave of the angle makes of back-EMF or inertia torque, at each harmonic.

        One wave is found for a trial: averaging its blocks must not make it more certain.
        """
        known = np.sqrt(N_BLOCKS) * np.concatenate([[0.0], state.ripple_std_rad])
        std = known[np.minimum(order.astype(int), len(known) - 1)] * (order < len(known))
        baseline = self.baseline
        faster = order * float(state.speed_rad_s.mean())
        if equation == "electrical":
            return baseline.plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * faster * std
        inertia = float(np.mean(baseline.inertia_kg_m2(baseline.mechanism.lever(state.angle_rad[0]))))
        return inertia / baseline.gear * faster**2 * std

    def nuisances(self) -> tuple[Nuisance, ...]:
        """See `diagnosis.inference.nuisances.nuisances_of`."""
        baseline = self.baseline
        return (
            *nuisances_of(baseline),
            *vibration_nuisances(baseline),
            *common_filter_nuisances(),
            *plunger_drive_nuisances(),
            *crosstalk_nuisances(),
            *map(of_known, self.known),
        )

    def readings(self) -> Mapping[str, Reading]:
        """See `diagnosis.inference.nuisances.READINGS`."""
        return READINGS

    def trial_nuisances(self, states: Sequence[State]) -> tuple[Nuisance, ...]:
        """Hardness of each stock and piece, numbers of each further battery, delays and filters of instruments."""
        cut = [s for s in states if not s.setting.is_idle]
        felt = [s for s in cut if s.kind == "running" and s.force_n is not None]
        stocks = dict.fromkeys(s.setting.stock for s in felt)
        labels = dict.fromkeys(s.setting.label for s in cut)
        std = _spread_std(self.baseline, felt)
        pieces = (*(_stock(name) for name in stocks), *(_spread(name, std) for name in labels))
        settings = [s.setting for s in states]
        of_force = force_filter_nuisances(self.baseline, states)
        instruments = (*clock_nuisances(settings), *bandwidth_nuisances(states), *of_force)
        return (*pieces, *further_batteries(self.baseline, settings), *instruments)

    def zero_wander(self, states: Sequence[State]) -> ZeroWander | None:
        """From the return strokes; see `diagnosis.inference.zero_wander`."""
        return zero_wander(zero_readings(self.baseline, states))

    def zero_signature(self, state: State) -> Signature:
        """The same at all angles, and in the load torque."""
        return force_offset(self.baseline, state)

    def force_beyond_crank(self, state: State) -> Signature:
        """By the linear cutting law; nothing in air, at a start, and where the displacement shows no such motion."""
        if state.blade_excess_m_s is None or state.force_n is None or state.setting.is_idle:
            return {}
        of_crank = self.baseline.expected_force(replace(state, blade_excess_m_s=None))
        return {"cutting": self.baseline.expected_force(state) - of_crank}

    def measured_rms(self, states: Sequence[State]) -> Mapping[str, float]:
        """Nothing: `diagnosis.screening` judges the channels of a saw."""
        del states
        return {}

    def weaknesses(self, states: Sequence[State]) -> list[str]:
        """Name the trials that lack a channel."""
        said = []
        for channel, reading in READINGS.items():
            missing = [s.setting.label for s in states if s.kind == "running" and reading.of(s) is None]
            if missing:
                said.append(
                    f"{channel} is missing in {', '.join(missing)}: effects visible only there cannot be identified"
                )
        return said

    def asymmetry(
        self, states: Sequence[State], effects: Sequence[str], parameters: Mapping[str, float]
    ) -> tuple[dict[str, Any], str]:
        """Nothing: a stroke of a saw has a cutting and a return half anyway."""
        del states, effects, parameters
        return {}, ""

    def next_trial(self, states: Sequence[State], *, has_gap: bool) -> str | None:
        """Idle run, duties, repeat, feed: what the campaign lacks first."""
        del has_gap
        settings = [s.setting for s in states if s.kind == "running"]
        if not any(s.is_idle for s in settings):
            return "an idle run (blade in air): it separates friction and supply from the cutting force"
        n_duties = len({s.duty for s in settings})
        if n_duties < _LEAST_DUTIES:
            return (
                f"the same stock at another duty ({n_duties} of at least {_LEAST_DUTIES} so far): a speed sweep"
                " separates friction, windage and voltage drops"
            )
        if len({s.operating_point for s in settings}) == len(settings):
            return "a repeat of one operating point: without repeats no statement beyond noise is possible"
        if len({s.feed_m_s for s in settings if not s.is_idle}) < 2:
            return "the same stock at another feed: it separates chip thickness from cutting speed"
        return None


def _stock(stock: str) -> Nuisance:
    def signature(baseline: Baseline, state: State) -> Signature:
        is_cut = state.setting.stock == stock and not state.setting.is_idle
        return {"cutting": baseline.cutting_speed(state)} if is_cut else {}

    std = SETTINGS.workpieces.stock_std_n_s_per_m
    return Nuisance(name=f"k_fc of {stock}", std=std, signature=signature)


def _spread_std(baseline: Baseline, felt: Sequence[State]) -> float:
    """How much one piece of a stock differs from the next: from repeats, drawn towards what woods usually do."""
    hardness: dict[str, list[float]] = {}
    for state in felt:
        assert state.force_n is not None
        force_n = state.force_n - baseline.known_signature(state).get("cutting", 0.0)
        k = float(coefficient(force_n, baseline.cutting_speed(state)))
        if k > 0:
            hardness.setdefault(state.setting.operating_point, []).append(float(np.log(k)))
    usual, degrees = SETTINGS.workpieces.piece_std, SETTINGS.workpieces.piece_degrees
    squares = usual**2 * degrees
    for values in hardness.values():
        squares += float(np.sum((np.array(values) - np.mean(values)) ** 2))
        degrees += len(values) - 1
    return float(np.clip(np.sqrt(squares / degrees), 0.3 * usual, 2.0 * usual))


def _spread(label: str, std: float) -> Nuisance:
    def signature(baseline: Baseline, state: State) -> Signature:
        return {"cutting": baseline.expected_force(state)} if state.setting.label == label else {}

    return Nuisance(name=f"k_fc spread of {label}", std=std, signature=signature)
