"""A wave in the wood is found by its wavelength; scatter, memory and what a hand does in time are not taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Signal, Trial
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.stroke_evidence import WAVE_IN_TIME, strokes_say, with_mean_strokes
from sawbench.diagnosis.inference.stroke_series import StrokeSeries, StrokeSpectra, stroke_series
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME, EFFECTS
from sawbench.modeling.effects.known import KnownEffect

from tests.rigs.jigsaw_in_time import BASELINE
from tests.rigs.processed import processed_trial

pytestmark = pytest.mark.unit

SCATTER = 0.045
WAVELENGTH_M, DEPTH = 0.005, 0.12
# Feed in m/s and strokes per second of the trials of a campaign.
OPERATION = ((0.003, 12.0), (0.003, 14.0), (0.006, 12.0), (0.006, 15.0), (0.004, 13.0), (0.005, 16.0))


def scatter(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Hardness from stroke to stroke without any wave."""
    if kind == "white":
        return SCATTER * rng.standard_normal(n)
    memory, found = 0.7, np.zeros(n)
    for k in range(1, n):
        found[k] = memory * found[k - 1] + np.sqrt(1 - memory**2) * SCATTER * rng.standard_normal()
    return found


def campaign(kind: str, seed: int, *, wavelength_m: float | None = None, frequency_hz: float | None = None) -> list:
    rng = np.random.default_rng(seed)
    found = []
    for number, (feed_m_s, rate_hz) in enumerate(OPERATION):
        n = int(20 * rate_hz)
        log_k = scatter(kind, n, rng)
        time_s, start = np.arange(n) / rate_hz, rng.uniform(0, 2 * np.pi)
        if wavelength_m is not None:
            log_k = log_k + DEPTH * np.sin(2 * np.pi * feed_m_s * time_s / wavelength_m + start)
        if frequency_hz is not None:
            log_k = log_k + DEPTH * np.sin(2 * np.pi * frequency_hz * time_s + start)
        found.append(
            StrokeSeries(
                label=f"t{number}", material="oak", feed_m_s=feed_m_s, rate_hz=rate_hz, log_k=log_k,
                k_n_s_per_m=300.0 * np.exp(log_k), time_s=time_s,
            )
        )  # fmt: skip
    return found


def grain(trials):
    return StrokeSpectra(trials).wave(EFFECT_BY_NAME["grain_variation"].strokes)


@pytest.mark.parametrize("kind", ["white", "with memory"])
@pytest.mark.parametrize("wavelength_m", [0.002, WAVELENGTH_M, 0.011])
def test_a_wave_along_the_feed_path_is_found_at_its_wavelength(kind, wavelength_m):
    found = grain(campaign(kind, 3, wavelength_m=wavelength_m))
    assert found.log_evidence > 20.0
    assert found.wavelength_m == pytest.approx(wavelength_m, rel=0.1)
    assert found.depth == pytest.approx(DEPTH, rel=0.25)


@pytest.mark.parametrize("kind", ["white", "with memory"])
def test_grain_of_one_material_has_its_depth_beside_trials_in_another(kind):
    wood = campaign(kind, 3, wavelength_m=WAVELENGTH_M)
    plastic = [replace(trial, material="nylon") for seed in (8, 9, 10) for trial in campaign(kind, seed)]
    found = grain([*plastic, *wood])
    assert found.log_evidence > 20.0
    assert found.depth == pytest.approx(DEPTH, rel=0.25)


@pytest.mark.parametrize("kind", ["white", "with memory"])
def test_scatter_alone_speaks_against_a_wave(kind):
    found = [grain(campaign(kind, seed)).log_evidence for seed in range(4)]
    assert max(found) < 1.0
    assert np.mean(found) < 0.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("std", [0.01, 0.03])
def test_wood_that_varies_along_the_cut_as_any_wood_does_is_no_grain(std, seed):
    """Less than pieces differ, remembered for some millimetres of feed whatever the stroke rate, and little scatter."""
    rng = np.random.default_rng(seed)
    trials = []
    for number, (feed_m_s, rate_hz) in enumerate(OPERATION):
        n = int(10 * rate_hz)
        memory, hardness = np.exp(-feed_m_s / rate_hz / 0.004), np.zeros(n)
        for k in range(1, n):
            hardness[k] = memory * hardness[k - 1] + np.sqrt(1 - memory**2) * std * rng.standard_normal()
        smooth = np.convolve(hardness, np.ones(5) / 5, mode="same") + 0.003 * rng.standard_normal(n)
        trials.append(
            StrokeSeries(
                label=f"t{number}", material="oak", feed_m_s=feed_m_s, rate_hz=rate_hz, log_k=smooth - smooth.mean(),
                k_n_s_per_m=300.0 * np.exp(smooth), time_s=np.arange(n) / rate_hz,
            )
        )  # fmt: skip
    assert grain(trials).log_evidence <= 0.0
    assert StrokeSpectra(trials).wave_in_time() <= 0.0


def test_a_wave_in_time_convinces_far_less_than_one_in_the_wood():
    """0.8 Hz is where the wave of 5 mm lies at the middle feed."""
    in_wood = StrokeSpectra(campaign("white", 5, wavelength_m=WAVELENGTH_M))
    in_time = StrokeSpectra(campaign("white", 5, frequency_hz=0.8))
    wave = EFFECT_BY_NAME["grain_variation"].strokes
    assert in_time.wave(wave).log_evidence < 0.5 * in_wood.wave(wave).log_evidence
    assert in_time.wave_in_time() > in_time.wave(wave).log_evidence + 20.0
    assert in_wood.wave(wave).log_evidence > in_wood.wave_in_time() + 20.0


def test_a_wave_in_the_wood_that_the_model_holds_is_no_wave_in_time():
    grain = EFFECT_BY_NAME["grain_variation"]
    known = KnownEffect(effect=grain, value=DEPTH, form=dict(grain.shapes[0]))
    others = [e for e in EFFECTS if e is not grain]

    def in_time(trials, *held):
        return strokes_say(others, [], trials, SETTINGS, held)[1][WAVE_IN_TIME]

    in_wood = campaign("white", 5, wavelength_m=WAVELENGTH_M)
    assert in_time(in_wood) > 20.0
    assert in_time(in_wood, known) < 0.0
    assert in_time(campaign("white", 5, frequency_hz=0.8), known) > 20.0


@pytest.mark.parametrize("frequency_hz", [0.43, 0.8, 0.93, 1.6, 2.7])
def test_where_all_trials_have_one_feed_a_wave_is_the_woods(frequency_hz):
    """In time and in the wood it is the same wave then, wherever it lies: the catalogue's name is the likelier one."""
    alike = [replace(trial, feed_m_s=0.004) for trial in campaign("white", 5, frequency_hz=frequency_hz)]
    said, looks = strokes_say(EFFECTS, [], alike, SETTINGS, ())
    grain = said["grain_variation"].alone
    assert grain > 20.0
    # A share of the prior of "unknown", and half as likely of the two.
    same = grain - np.log(2.0 * SETTINGS.strokes.looks)
    assert looks[WAVE_IN_TIME] == pytest.approx(same, abs=0.6)


@pytest.mark.parametrize(("feeds_m_s", "adds"), [((0.004, 0.004), True), ((0.004, 0.006), False)])
def test_where_all_trials_have_one_feed_mean_strokes_say_the_same_of_a_wave_in_time(feeds_m_s, adds):
    """Else chance in the means would tell apart what the strokes cannot, either way."""
    trials = [replace(t, feed_m_s=v) for t, v in zip(campaign("white", 5, frequency_hz=0.8), feeds_m_s, strict=False)]
    said, looks = strokes_say(EFFECTS, [], trials, SETTINGS, ())
    for of_means in (-3.0, 9.0):
        found = with_mean_strokes(looks, said, trials, {"grain_variation": of_means, "edge_force": 100.0})
        assert found[WAVE_IN_TIME] == pytest.approx(looks[WAVE_IN_TIME] + (of_means if adds else 0.0))


def test_mean_strokes_make_no_wave_where_the_strokes_show_none():
    trials = [replace(trial, feed_m_s=0.004) for trial in campaign("white", 5)]
    said, looks = strokes_say(EFFECTS, [], trials, SETTINGS, ())
    assert said["grain_variation"].alone <= 0.0
    assert with_mean_strokes(looks, said, trials, {"grain_variation": 50.0}) == looks


def cut_trial(seconds=12.0, strokes_hz=20.0, hole_s=0.0, later_s=0.0):
    """A cut of constant hardness, with noise, and a hole in its force in the middle or a little later."""
    time_s = np.arange(0.0, seconds, 5e-4)
    turned = 2.0 * np.pi * strokes_hz * time_s
    mechanism = BASELINE.mechanism
    force_n = 300.0 * np.maximum(-mechanism.lever(turned) * 2.0 * np.pi * strokes_hz, 0.0)
    force_n += 3.0 * np.random.default_rng(6).standard_normal(len(time_s))
    kept = np.abs(time_s - 0.5 * seconds - later_s) >= 0.5 * hole_s
    angle = CrankAngle(
        time_s=time_s, angle_rad=turned, speed_rad_s=np.full(len(time_s), 2.0 * np.pi * strokes_hz),
        angle_std_rad=np.zeros(len(time_s)), radius_m=mechanism.radius_m, source="displacement_mm", is_absolute=True,
    )  # fmt: skip
    force = Signal(channel="force_n", unit="N", time_s=time_s[kept], values=force_n[kept])
    trial = Trial(trial_id="t", duty=0.5, material="oak", feed_mm_s=3.0)
    return processed_trial(trial, {"force_n": force}, angle, 0.0, seconds)


@pytest.mark.parametrize("later_s", np.arange(0.0, 0.05, 0.005).tolist())
def test_strokes_without_samples_cost_themselves_and_no_trial(later_s):
    """Two strokes and a half, wherever the hole begins in a stroke."""
    found = stroke_series(cut_trial(hole_s=0.12, later_s=later_s), mechanism=BASELINE.mechanism, cutting_sign=-1)
    whole = stroke_series(cut_trial(), mechanism=BASELINE.mechanism, cutting_sign=-1)
    assert np.all(np.diff(found.time_s) > 0.0)
    assert np.abs(found.log_k).max() < 2.0 * np.abs(whole.log_k).max()
    assert np.abs(found.k_n_s_per_m - 300.0).max() < 2.0 * np.abs(whole.k_n_s_per_m - 300.0).max()


def test_a_trial_of_which_half_is_missing_says_nothing():
    assert stroke_series(cut_trial(hole_s=6.0), mechanism=BASELINE.mechanism, cutting_sign=-1) is None
