"""Delays that a recording states itself are no gap: they have the form of what late channels do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.recording import Alignment
from sawbench.diagnosis.inference.clocks import clock_nuisances

from tests.rigs.drawn_states import setting_of
from tests.rigs.jigsaw_in_time import BASELINE, K_CUT, N_POINTS, Machine, compare, gap

pytestmark = pytest.mark.unit

LATE_S = 3e-4
N_HARMONICS = 24
CHANNEL_OF = {
    "force": "force_n", "displacement": "displacement_mm", "motor": "motor_current_a", "battery": "battery_current_a",
}  # fmt: skip


def known(*channels, std_s=2e-4, latency_s=1e-3):
    return {channel: Alignment(std_s=std_s, latency_s=latency_s) for channel in channels}


def _saturating(speed_m_s, travelled_m, force_n):
    return K_CUT * speed_m_s / (1.0 + speed_m_s / 0.3)


def _compared(waves):
    """In the harmonics that the diagnosis compares: a kink that moves by half a point of the grid is more than that."""
    spectra = {name: np.fft.rfft(wave)[..., : N_HARMONICS + 1] for name, wave in waves.items()}
    return {name: np.fft.irfft(spectrum, N_POINTS) for name, spectrum in spectra.items()}


INTACT = Machine().run()


def seen_and_claimed(late, **law):
    """What a stream that is late in one trial leaves, and what its nuisance says."""
    state = Machine(**law, late={late: LATE_S}).run()
    intact = gap(Machine(**law).run())
    setting = replace(state.setting, alignments=known(CHANNEL_OF[late]))
    (nuisance,) = (n for n in clock_nuisances([setting]) if n.name == f"clock of {CHANNEL_OF[late]} in t")
    other = replace(state, setting=replace(state.setting, label="another trial"))
    assert nuisance.signature(BASELINE, other) == {}
    seen = {name: wave - intact[name] for name, wave in gap(state).items()}
    return seen, {name: LATE_S * wave for name, wave in nuisance.signature(BASELINE, state).items()}


@pytest.mark.parametrize("late", ["force", "displacement", "motor", "battery"])
def test_a_stream_that_is_late_in_one_trial_leaves_what_its_nuisance_says(late):
    compare(*seen_and_claimed(late), 0.15)


@pytest.mark.parametrize("late", ["force", "displacement", "motor", "battery"])
def test_what_the_linear_law_misses_of_the_force_is_late_too(late):
    seen, claimed = seen_and_claimed(late, cut=_saturating)
    compare(_compared(seen), _compared(claimed), 0.15)


def test_each_trial_has_its_alignment_and_all_share_the_latency_of_a_stream():
    channels = (*CHANNEL_OF.values(), "battery_voltage_v")
    settings = [
        replace(setting_of(is_idle=False), label=label, alignments=known(*channels, std_s=std_s))
        for label, std_s in (("t1", 1e-4), ("t1", 1e-4), ("t2", 3e-4))
    ]
    found = {n.name: n.std for n in clock_nuisances(settings)}
    # Anything from 0 to 1 ms, evenly: a standard deviation of 1 ms / sqrt(12).
    latency = {f"latency of {name}": 1e-3 / np.sqrt(12.0) for name in CHANNEL_OF.values()}
    clocks = {
        f"clock of {name} in {label}": std_s
        for label, std_s in (("t1", 1e-4), ("t2", 3e-4))
        for name in CHANNEL_OF.values()
    }
    assert found == pytest.approx(latency | clocks)


def test_a_latency_counts_from_the_middle_of_the_smallest_one():
    setting = replace(
        setting_of(is_idle=False),
        alignments=known("force_n", latency_s=4e-4) | known("motor_current_a", latency_s=2e-3),
    )
    found = {n.name: n.std for n in clock_nuisances([setting])}
    # Even from 0 to 2 ms about the middle of 0 to 0.4 ms: the root of the mean of (t - 0.2 ms)^2.
    late_s = np.linspace(0.0, 2e-3, 100_001)
    assert found["latency of motor_current_a"] == pytest.approx(np.sqrt(np.mean((late_s - 2e-4) ** 2)), rel=1e-3)
    assert found["latency of force_n"] == pytest.approx(4e-4 / np.sqrt(12.0))


def test_what_states_nothing_leaves_nothing_open():
    assert list(clock_nuisances([setting_of(is_idle=False)])) == []


def test_all_devices_late_alike_are_late_for_nobody():
    setting = replace(INTACT.setting, alignments=known(*CHANNEL_OF.values()))
    late = [
        n.signature(BASELINE, replace(INTACT, setting=setting))
        for n in clock_nuisances([setting]) if n.name.startswith("latency")
    ]  # fmt: skip
    for equation in ("electrical", "mechanical", "cutting"):
        waves = [one.get(equation, np.zeros_like(INTACT.angle_rad)) for one in late]
        alone = max(float(np.abs(wave).max()) for wave in waves)
        assert np.abs(sum(waves)).max() < 0.01 * alone
