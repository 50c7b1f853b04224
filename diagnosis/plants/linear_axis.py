"""Diagnosis of a linear axis (`modeling.machines.linear_axis`): its campaign, uncertainties and next trial."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sawbench.bench.config import LinearAxisConfig, LoadedConfig
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.plain_digits import plain
from sawbench.bench.recording import Floats, Recording
from sawbench.bench.units import DISPLACEMENT
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.features import Layout, harmonics, orders, times_over_angles
from sawbench.diagnosis.inference.nuisance import Nuisance, Reading
from sawbench.diagnosis.inference.nuisances import of_known
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.plants.axis_friction import both_ways_n, friction_by_direction, friction_n
from sawbench.diagnosis.plants.axis_motion import (
    LEAST_POINTS,
    average,
    axis_state,
    find_cycles,
    has_several_speeds,
)
from sawbench.diagnosis.plants.axis_windows import find_windows, window_states
from sawbench.diagnosis.plants.plant import EquationForm
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.machines.known_effects import known_effects
from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState, as_axis, bare_residuals, residuals
from sawbench.modeling.machines.machine import Machine
from sawbench.modeling.machines.table import axis_of
from sawbench.modeling.residuals import Equation, Signature
from sawbench.modeling.state import State, TrialSetting

N_HARMONICS = 32
_FRICTION = "guide_friction"
# Octaves of the cycle.
_NOISE_BANDS = (4, 8, 16)


@dataclass(frozen=True, kw_only=True, slots=True)
class LinearAxis:
    """The axis as a plant; see `diagnosis.plants.plant.Plant`."""

    model: AxisBaseline

    @property
    def config(self) -> LinearAxisConfig:
        """Its `[linear_axis]` table."""
        return self.model.config

    @property
    def machine(self) -> Machine:
        """What it is made of."""
        return axis_of(self.config)

    @property
    def equations(self) -> Mapping[Equation, EquationForm]:
        """The balance of forces."""
        constant = self.config.force_constant_n_per_a
        form = EquationForm(
            unit="N",
            place="mechanical",
            channel=self.config.drive_channel,
            channel_unit="N" if constant is None else "A",
            to_channel=1.0 if constant is None else 1.0 / constant.nominal,
            n_harmonics=N_HARMONICS,
            noise_bands=_NOISE_BANDS,
        )
        return {"mechanical": form}

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Those whose parts it has, in sizes of this campaign, but for the known ones."""
        known = {one.effect.name for one in self.known}
        return tuple(e for e in self.machine.effects(self.model) if e.name not in known)

    @property
    def known(self) -> tuple[KnownEffect, ...]:
        """Those that the model holds."""
        return self.model.known

    def with_known(self, known: Sequence[KnownEffect]) -> LinearAxis:
        """See `Plant.with_known`."""
        return replace(self, model=replace(self.model, known=tuple(known)))

    @property
    def beyond_catalogue(self) -> tuple[Effect, ...]:
        """None are known."""
        return ()

    @property
    def turns_a_cycle(self) -> None:
        """Its motor is not modelled."""
        return

    @property
    def expected_rest(self) -> float:
        """All that its model error says: it holds what the form of a cause may miss, not only a floor."""
        return 1.0

    @property
    def scale_rel_std(self) -> float:
        """Of the drive's force: the balance holds as well with all forces larger by the same factor."""
        constant = self.config.force_constant_n_per_a
        return self.config.drive_gain_rel_std if constant is None else constant.rel_std

    @property
    def zero_std_n(self) -> float:
        """Standard uncertainty of the zeros of drive and load together, N."""
        config = self.config
        offset = SETTINGS.axis.offset_share * self.model.force_scale_n
        zeros = [offset if config.drive_offset_std_n is None else config.drive_offset_std_n]
        if config.load_channel is not None:
            zeros.append(offset if config.load_offset_std_n is None else config.load_offset_std_n)
        return float(np.hypot.reduce(zeros))

    def residuals(self, state: State) -> Signature:
        """See `modeling.machines.linear_axis.bare_residuals`."""
        return bare_residuals(self.model, state)

    def smooth(self, state: State, blocks: Floats) -> State:
        """Units averaged into blocks; the motion is a short Fourier series already."""
        return average(as_axis(state), blocks)

    def model_error(self, layout: Layout, state: State) -> Floats:
        """Covariance, N^2: a floor at every harmonic, a share of what no form hits, and anything at standstill.

        No form hits what is missing, nor what the model holds as known effects. A constant force is no form of a term.
        """
        floor_n = self.config.model_floor_n or SETTINGS.axis.floor_share * self.model.force_scale_n
        unsure = (residuals(self.model, state), self.model.known_signature(state))
        forces = [one["mechanical"] for one in unsure if one]
        moving: list[Signature] = [{"mechanical": one - both_ways_n(as_axis(state), one)} for one in forces]
        features = [layout.place(one, times_over_angles(state)).mean(axis=0) for one in moving]
        unsure_n = float(np.linalg.norm(features))
        order = orders((layout.size - 1) // 2)
        shape = 1.0 / (1.0 + order / SETTINGS.axis.form_harmonic)
        floor = np.hypot(floor_n, SETTINGS.axis.form_share * unsure_n * shape / np.linalg.norm(shape))
        speed = np.abs(as_axis(state).velocity_m_s.mean(axis=0))
        impulses = np.eye(len(speed))[speed < SETTINGS.axis.standstill_share * speed.max()]
        # White over the grid: on a finer one as much of it falls on each harmonic.
        size_n = unsure_n * np.sqrt(len(speed) / LEAST_POINTS)
        standstill = size_n * layout.place({"mechanical": impulses}, np.ones_like(impulses))
        return np.diag(floor**2) + standstill.T @ standstill

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Mass, damping, force constant or gain of the drive, gain of the load, zero of the forces."""
        config = self.config
        constant = config.force_constant_n_per_a
        found = [
            _plant("moving_mass_kg", config.moving_mass_kg, _acceleration),
            _plant("viscous_damping_n_s_per_m", config.viscous_damping_n_s_per_m, _velocity),
            _sensor("drive_gain", config.drive_gain_rel_std, _asked_force)
            if constant is None
            else _plant("force_constant_n_per_a", constant, _asked_current),
            _sensor("force_offset_n", self.zero_std_n, _ones),
        ]
        if config.load_channel is not None:
            found.append(_sensor("load_gain", config.load_gain_rel_std, _load_gain))
        return tuple(n for n in (*found, *map(of_known, self.known)) if n.std > 0)

    def trial_nuisances(self, states: Sequence[State]) -> tuple[Nuisance, ...]:
        """Constant force of each load that is not measured (a weight, a brake): no part of the axis."""
        if self.config.load_channel is not None:
            return ()
        loads = dict.fromkeys(s.setting.stock for s in states if not s.setting.is_idle)
        return tuple(_constant_load(name, self.model.force_scale_n) for name in loads)

    def zero_wander(self, states: Sequence[State]) -> None:
        """An axis never moves without its load: no part of the cycle reads the zero."""
        return

    def readings(self) -> Mapping[str, Reading]:
        """None: `model_floor_n` holds what the sensors of an axis leave."""
        return {}

    def zero_signature(self, state: State) -> Signature:
        """Nothing: see `zero_wander`."""
        del state
        return {}

    def force_beyond_crank(self, state: State) -> Signature:
        """Nothing: an axis has no crank."""
        del state
        return {}

    def measured_rms(self, states: Sequence[State]) -> Mapping[str, float]:
        """Root mean square of the drive about its mean; see `Plant.measured_rms`."""
        form = self.equations["mechanical"]
        waves = np.array([harmonics(as_axis(s).drive_n.mean(axis=0), form.n_harmonics)[1:] for s in states])
        rms_n = float(np.sqrt(0.5 * np.mean(np.sum(waves**2, axis=1))))
        return {form.channel: (form.to_channel or 1.0) * rms_n}

    def weaknesses(self, states: Sequence[State]) -> list[str]:
        """Say that friction and load are one where the load is not measured."""
        if self.config.load_channel is not None:
            return []
        return ["no load_channel: an unmeasured load is indistinguishable from a model error of the axis"]

    def asymmetry(
        self, states: Sequence[State], effects: Sequence[str], parameters: Mapping[str, float]
    ) -> tuple[dict[str, Any], str]:
        """Dry friction by direction, where the cause holds it, with the mass as re-tuned."""
        mass_kg = parameters.get("moving_mass_kg", self.config.moving_mass_kg.nominal)
        if _FRICTION not in effects:
            return {}, ""
        found = [as_axis(s) for s in states]
        # A gain that is wrong makes a constant force of a mean one.
        drive_n = float(np.mean([s.drive_n.mean() for s in found]))
        load_n = float(np.mean([0.0 if s.force_n is None else s.force_n.mean() for s in found]))
        gains_n = np.hypot(self.scale_rel_std * drive_n, self.config.load_gain_rel_std * load_n)
        by = friction_by_direction(found, mass_kg, zero_std_n=float(np.hypot(self.zero_std_n, gains_n)))
        return ({}, "") if by is None else (by.report(), by.words() if by.is_significant else "")

    def next_trial(self, states: Sequence[State], *, has_gap: bool) -> str | None:
        """Another speed, another load, and where there is a gap a repeat."""
        settings = [s.setting for s in states]
        if not has_several_speeds([as_axis(s) for s in states]):
            what = "motion" if all(s.is_idle for s in settings) or self.config.load_channel is None else "load"
            return f"the same {what} at another speed: it separates dry from viscous friction"
        if self.config.load_channel is not None and len({s.stock for s in settings}) < 2:
            return "the same rate at another load, or none: it separates friction of the guide from that of the load"
        if has_gap and len({s.operating_point for s in settings}) == len(settings):
            return "a repeat of one operating point: without repeats no statement beyond noise is possible"
        return None


def _acceleration(_: AxisBaseline, state: State) -> Signature:
    return {"mechanical": as_axis(state).acceleration_m_s2}


def _velocity(_: AxisBaseline, state: State) -> Signature:
    return {"mechanical": as_axis(state).velocity_m_s}


def _asked_force(axis: AxisBaseline, state: State) -> Signature:
    """Force that motion and load ask for, not the measured one: as for the torque constant of the jigsaw."""
    return {"mechanical": -axis.required_force(as_axis(state))}


def _asked_current(axis: AxisBaseline, state: State) -> Signature:
    constant = axis.config.force_constant_n_per_a
    assert constant is not None
    return {"mechanical": -axis.required_force(as_axis(state)) / constant.nominal}


def _ones(_: AxisBaseline, state: State) -> Signature:
    return {"mechanical": np.ones_like(state.angle_rad)}


def _load_gain(_: AxisBaseline, state: State) -> Signature:
    return {} if state.force_n is None else {"mechanical": -state.force_n}


def _constant_load(load: str, std_n: float) -> Nuisance:
    def signature(_: AxisBaseline, state: State) -> Signature:
        return {"mechanical": np.ones_like(state.angle_rad)} if state.setting.stock == load else {}

    return _sensor(f"constant force of {load}", std_n, signature)


def _plant(name, value, signature) -> Nuisance:
    std = max(value.std, 1e-3 * abs(value.nominal))
    return Nuisance(name=name, nominal=value.nominal, std=std, is_plant=True, signature=signature)


def _sensor(name, std, signature) -> Nuisance:
    return Nuisance(name=name, std=std, signature=signature)


def reduce_axis(
    recordings: Sequence[Recording],
    loaded: LoadedConfig,
    *,
    on_trial: Callable[[int, int, str], None] | None = None,
) -> Campaign:
    """Reduce the recordings of an axis.

    Parameters
    ----------
    recordings : sequence of Recording
        With `displacement_mm`, the drive's channel and, unless nothing loads the axis (workpiece "none"), the
        load's channel, if the configuration names one.
    loaded : LoadedConfig
    on_trial : callable, optional
        (done, total, name).

    Returns
    -------
    Campaign
        `TrialSetting.duty` holds the cycle rate in Hz, the speed of a plant that has no duty.

    Raises
    ------
    ConfigError
        If there is no `[linear_axis]` table.
    InputError
        If no trial can be used, or the drive takes power from the axis instead of giving it, or forces
        and motion are far from what the stated mass and damping allow.
    """
    config = loaded.config.linear_axis
    if config is None:
        raise ConfigError("has no [linear_axis] table", where=loaded.path)
    warnings: list[str] = []
    states: list[AxisState] = []
    for number, recording in enumerate(recordings):
        states += _states(recording, recordings[0], number, config, warnings)
        if on_trial is not None:
            on_trial(number + 1, len(recordings), recording.trial.trial_id)
    if not states:
        there = dict.fromkeys(name for recording in recordings for name in recording.signals)
        raise InputError(
            f"no trial can be diagnosed: {'; '.join(warnings)}",
            where=loaded.path,
            remedy=f"the recordings have {', '.join(there)}: name the drive as drive_channel, the load as load_channel"
            " in [linear_axis], leave load_channel out where the load is not measured; a run without a load has the"
            " material none (`sawbench amend FILE --material none`)",
        )
    _refuse_wrong_sign(states, config)
    _refuse_wrong_unit(states, config)
    force_scale_n = float(np.sqrt(2.0) * max(np.std(s.drive_n) for s in states))
    baseline = AxisBaseline(
        config=config,
        force_scale_n=force_scale_n,
        stroke_m=max(float(np.ptp(s.position_m)) for s in states),
        top_speed_m_s=max(float(np.abs(s.velocity_m_s).max()) for s in states),
        # Less is what the model of a real axis misses anyway.
        friction_n=max(friction_n(states, config), SETTINGS.axis.floor_share * force_scale_n),
    )
    known = known_effects(loaded.config, path=loaded.path, model=baseline)
    axis = LinearAxis(model=replace(baseline, known=known))
    return Campaign(plant=axis, states=tuple(states), k_guess_n_s_per_m={}, warnings=tuple(warnings))


def _states(
    recording: Recording, first: Recording, index: int, config: LinearAxisConfig, warnings: list[str]
) -> list[AxisState]:
    """States of one trial: its cycles, or windows of a motion that has none; none where it is left out."""
    trial = recording.trial
    loaded_axis = config.load_channel is not None and not (
        trial.is_idle and config.load_channel not in recording.signals
    )
    needed = [DISPLACEMENT.name, config.drive_channel, *([config.load_channel] if loaded_axis else [])]
    missing = [name for name in needed if name not in recording.signals]
    if missing:
        warnings.append(f"{trial.trial_id} left out: it has no {' and no '.join(str(name) for name in missing)}")
        return []
    displacement, drive = recording.signals[DISPLACEMENT.name], recording.signals[config.drive_channel]
    load = recording.signals[str(config.load_channel)] if loaded_axis else None
    newton = 1.0 if config.force_constant_n_per_a is None else config.force_constant_n_per_a.nominal
    cycles, said = find_cycles(displacement)
    if cycles is not None:
        warnings += [f"{trial.trial_id}: {said} and are left out"] if said else []
        setting = _setting(recording, first, index, cycles.rate_hz, plain(cycles.rate_hz, "Hz"))
        return [axis_state(cycles, setting, displacement, drive, load, newton)]
    windows, why = find_windows(displacement, drive, N_HARMONICS)
    if windows is None:
        warnings.append(f"{trial.trial_id} left out: {why}")
        return []
    warnings.append(
        f"{trial.trial_id}: {said}; its motion is compared over time, in {_counted(len(windows.edges_s) - 1)}"
    )
    # Steps as long as the shortest motion: the noise of single samples is no path.
    step = max(1, int(displacement.rate_hz / (4.0 * windows.cutoff_hz)))
    path_mm = float(np.abs(np.diff(displacement.values[::step])).sum())
    rate_hz = path_mm / max(2.0 * float(np.ptp(displacement.values)) * displacement.duration_s, 1e-12)
    setting = _setting(recording, first, index, rate_hz, f"{plain(displacement.duration_s, 's')} of free motion")
    signals = {"displacement": displacement, "drive": drive, "load": load}
    return window_states(windows, setting, signals, newton)


def _counted(n: int) -> str:
    return "one window" if n == 1 else f"{n} windows"


def _setting(recording: Recording, first: Recording, index: int, rate_hz: float, motion: str) -> TrialSetting:
    trial, begun = recording.trial, first.trial.started_at
    here = trial.started_at
    stroke_m = 1e-3 * float(np.ptp(np.quantile(recording.signals[DISPLACEMENT.name].values, (0.01, 0.99))))
    load = trial.material or "load not stated"
    return TrialSetting(
        label=trial.trial_id,
        index=index,
        duty=rate_hz,
        is_idle=trial.is_idle,
        stock=load,
        feed_m_s=np.nan,
        thickness_m=np.nan,
        operating_point=f"{load}, {motion}, stroke {plain(stroke_m, 'm')}",
        session_s=0.0 if begun is None or here is None else (here - begun).total_seconds(),
    )


def _refuse_wrong_sign(states: Sequence[AxisState], config: LinearAxisConfig) -> None:
    """What drive and load leave must brake: a passive axis gives no power."""
    power_w = spent_w = 0.0
    for state in states:
        load = 0.0 if state.force_n is None else state.force_n
        power_w += float(np.mean((state.drive_n - load) * state.velocity_m_s))
        spent_w += float(np.mean(np.abs((state.drive_n - load) * state.velocity_m_s)))
    if power_w < -0.2 * spent_w:
        raise InputError(
            f"drive and load together give {plain(-power_w, 'W')} to a passive axis",
            remedy=f"check the signs: positive {config.drive_channel} must drive towards larger {DISPLACEMENT.name}, "
            "a positive load push towards smaller",
        )


def _refuse_wrong_unit(states: Sequence[AxisState], config: LinearAxisConfig) -> None:
    """Mass and damping that the recordings ask for beside dry friction cannot be 30 times what is stated, nor less."""
    v, a, force_n = (np.concatenate([np.ravel(x) for x in found]) for found in zip(*map(_motion, states), strict=True))
    terms = np.stack([a, v, np.sign(v), np.ones_like(v)], axis=1)
    found = np.linalg.lstsq(terms, force_n, rcond=None)[0]
    left_n = float(np.std(force_n - terms @ found))
    stated = (
        ("moving_mass_kg", config.moving_mass_kg),
        ("viscous_damping_n_s_per_m", config.viscous_damping_n_s_per_m),
    )
    said = [
        f"{name} would have to be {plain(value)}, {one.nominal:g} is stated"
        for (name, one), value, term in zip(stated, found, terms.T, strict=False)
        if value * np.std(term) > left_n and value > SETTINGS.screening.another_machine * (one.nominal + 2.0 * one.std)
    ]
    least = [max(one.nominal - 2.0 * one.std, 0.0) for _, one in stated]
    asked_n, measured_n = float(np.std(terms[:, :2] @ least)), float(np.std(force_n))
    if asked_n > SETTINGS.screening.another_machine * measured_n:
        asked, measured = plain(asked_n, "N"), plain(measured_n, "N")
        said.append(f"the motion asks for a force of {asked} rms, drive less load has {measured} rms")
    if said:
        raise InputError(
            f"recordings and configuration do not describe the same axis: {'; '.join(said)}",
            remedy=f"check which column is {DISPLACEMENT.name} and which {config.drive_channel}, their units and the"
            " unit of the time, then the values in [linear_axis]",
        )


def _motion(state: AxisState) -> tuple[Floats, Floats, Floats]:
    """Velocity, acceleration, and drive less load about its mean over the trial."""
    force_n = state.drive_n - (0.0 if state.force_n is None else state.force_n)
    return state.velocity_m_s, state.acceleration_m_s2, force_n - force_n.mean()
