"""A long recording gives piece by piece what it gives whole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import sawbench
from sawbench.analysed_trial import AnalysedTrial
from sawbench.analysis import evaluate, fit_trial, load_and_process
from sawbench.bench.recording import Event, Recording, Signal, Trial
from sawbench.long_trials import OUTLINE_RATE_HZ, process_long
from sawbench.model_cycles import fitted_cycle
from sawbench.processing.joined import join_processed, which_count
from sawbench.storage.reader import read_recording, write_recording

from benchmarks import synthetic_trials as synthetic

pytestmark = pytest.mark.pipeline

RATE_HZ, SECONDS = 1000.0, 12.0
CONFIG = (Path(__file__).parents[2] / "bench_config.toml").read_text()
DUTY, K_FC, K_FC_SPREAD = 0.4375, 240.0, 0.04
# Strokes that cut: the saw makes 17.6 strokes per second in air and 13.9 in the wood. Pieces end at 10.5 and 20.8 s.
CUTS = {
    "air in the first piece": slice(200, None),
    "air but for the last strokes of the first piece": slice(168, None),
    "air in the last piece": slice(None, 280),
    "air in the middle piece": np.r_[0:120, 360:1000],
}


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Twelve seconds of the model's settled cut with noise, whole and in pieces of about two seconds."""
    run = sawbench.simulate(k_fc_n_s_per_m=240.0, duration_s=SECONDS, rate_hz=RATE_HZ).recording(material="oak")
    rng, made = np.random.default_rng(4), run.recording
    signals = {
        name: Signal(
            channel=name, unit=one.unit, time_s=one.time_s,
            values=one.values + 1e-3 * np.ptp(one.values) * rng.normal(size=len(one.values)),
        )
        for name, one in made.signals.items()
    }  # fmt: skip
    trial = Trial(trial_id="long", material="oak", duty=made.trial.duty, feed_mm_s=4.0)
    recording = Recording(trial=trial, signals=signals, config_toml=made.config_toml)
    path = write_recording(recording, tmp_path_factory.mktemp("long") / "long.mcap")
    return load_and_process(path, None), in_pieces(path, seconds=2.0)


def in_pieces(path, *, seconds):
    return process_long(path, None, path=str(path), sha256="s", n_samples=round(seconds * 5 * RATE_HZ))


@dataclass(frozen=True, kw_only=True)
class Integrated:
    """A trial of the independent integrator with nominal plant constants, in pieces, and what is true of its cut.

    `means` are those from one second on, when the current of the start is over.
    """

    trial: AnalysedTrial
    cut_s: float
    n_strokes: int
    means: dict[str, float]


def integrated(folder, k_per_stroke, *, seconds, of_piece_s, **battery_as):
    plant = {name: value for name, (value, _) in synthetic.NOMINAL.items()}
    time_s, current, _, crank, force, voltage, battery = synthetic.simulate(
        plant, k_per_stroke, DUTY, seconds, RATE_HZ, **battery_as
    )
    rng = np.random.default_rng(2)
    channels = {
        "displacement_mm": ("mm", 10.0 * (1.0 - np.cos(crank)), 0.005),
        "force_n": ("N", force, 0.5),
        "motor_current_a": ("A", current, 0.05),
        "battery_voltage_v": ("V", voltage, 0.01),
        "battery_current_a": ("A", battery, 0.02),
    }
    signals = {
        name: Signal(channel=name, unit=unit, time_s=time_s, values=true + noise * rng.normal(size=len(true)))
        for name, (unit, true, noise) in channels.items()
    }
    trial = Trial(trial_id="long", material="oak", duty=DUTY, feed_mm_s=4.0)
    recording = Recording(trial=trial, signals=signals, config_toml=CONFIG)
    path = write_recording(recording, folder / "integrated.mcap")
    cuts = k_per_stroke[(crank // (2.0 * np.pi)).astype(int)] > 0.0
    return Integrated(
        trial=in_pieces(path, seconds=of_piece_s),
        cut_s=cuts.sum() / RATE_HZ,
        n_strokes=round(np.diff(crank)[cuts[1:]].sum() / (2.0 * np.pi)),
        means={name: float(true[cuts & (time_s > 1.0)].mean()) for name, (_, true, _) in channels.items()},
    )


@pytest.fixture(scope="module", params=CUTS)
def partly_in_air(request, tmp_path_factory):
    k_per_stroke = np.zeros(1000)
    scatter = K_FC_SPREAD * np.random.default_rng(1).normal(size=1000)
    k_per_stroke[CUTS[request.param]] = K_FC * (1.0 + scatter[CUTS[request.param]])
    return integrated(tmp_path_factory.mktemp("air"), k_per_stroke, seconds=30.0, of_piece_s=10.0)


def test_strokes_and_their_means_are_those_of_the_whole(both):
    whole, joined = (one.processed for one in both)
    n_cuts = round(SECONDS / 2.0)
    assert joined.status == whole.status == "cutting"
    assert whole.period.n_cycles - 2 * n_cuts <= joined.period.n_cycles <= whole.period.n_cycles
    assert abs(joined.period.period_s / whole.period.period_s - 1.0) < 1e-3
    for name, cycle in whole.folded.items():
        span = np.ptp(cycle.mean)
        assert np.abs(joined.folded[name].mean - cycle.mean).max() < 0.01 * span, name
    assert abs(joined.peak_force_n - whole.peak_force_n) < 0.01 * whole.peak_force_n
    for values in ("mean_values", "rms_values"):
        for name, value in getattr(whole, values).items():
            assert getattr(joined, values)[name] == pytest.approx(value, rel=0.01), name
    for ours, theirs in zip(joined.quality, whole.quality, strict=True):
        assert (ours.n_samples, ours.n_missing) == (theirs.n_samples, theirs.n_missing)
        assert ours.noise_std == pytest.approx(theirs.noise_std, rel=0.1)
    assert [phase.kind for phase in joined.phases][-1] == "running"


def test_the_fit_agrees_within_its_uncertainty(both):
    whole, joined = (evaluate(one) for one in both)
    assert (whole.fit.status, joined.fit.status) == ("ok", "ok")
    assert abs(whole.fit.k_fc_n_s_per_m - joined.fit.k_fc_n_s_per_m) < 0.5 * whole.fit.std_n_s_per_m
    assert joined.runtime.runtime_s == pytest.approx(whole.runtime.runtime_s, rel=0.01)


def test_the_outline_is_short_and_keeps_every_peak(both):
    whole, joined = (one.recording for one in both)
    for name, one in joined.signals.items():
        full = whole.signals[name]
        assert len(one.values) < 0.5 * len(full.values)
        assert (one.values.min(), one.values.max()) == (full.values.min(), full.values.max())
        assert np.diff(one.time_s).max() < 4.0 / OUTLINE_RATE_HZ
    assert "processed in" in both[1].processed.warnings[-1]


def test_pieces_in_air_are_none_of_the_cut(partly_in_air):
    true, joined = partly_in_air, partly_in_air.trial.processed
    assert joined.status == "cutting"
    assert joined.period.rate_hz == pytest.approx(true.n_strokes / true.cut_s, rel=0.01)
    for name, mean in true.means.items():
        assert joined.mean_values[name] == pytest.approx(mean, rel=0.01), name
    assert joined.folded["force_n"].mean.max() == pytest.approx(joined.peak_force_n, rel=0.02)
    running_s = sum(phase.end_s - phase.start_s for phase in joined.phases if phase.kind == "running")
    assert running_s == pytest.approx(true.cut_s, abs=1.5)
    assert sum(one.n_samples for one in joined.quality) == 5 * 30.0 * RATE_HZ


def test_strokes_in_air_are_not_fitted_and_not_drawn(partly_in_air):
    fit, _ = fit_trial(partly_in_air.trial)
    assert fit.status == "ok"
    assert abs(fit.k_fc_n_s_per_m - K_FC) < 2.0 * fit.std_n_s_per_m < 0.02 * K_FC
    cycle = fitted_cycle(partly_in_air.trial, fit)
    assert cycle["motor_current_a"].mean() == pytest.approx(partly_in_air.means["motor_current_a"], rel=0.02)
    drawn = partly_in_air.trial.processed
    in_cut = (drawn.angle.time_s > drawn.steady.settled_s) & (drawn.angle.time_s < drawn.steady.end_s)
    rate_hz = drawn.angle.speed_rad_s[in_cut].mean() / (2.0 * np.pi)
    assert rate_hz == pytest.approx(partly_in_air.n_strokes / partly_in_air.cut_s, rel=0.02)


@pytest.mark.parametrize(
    ("statuses", "expected"),
    [
        (("cutting", "no_cutting"), [True, False]),
        (("no_cutting", "cutting", "stalled in the wood", "no_stroke"), [False, True, True, False]),
        (("no_cutting", "stalled in the wood"), [False, True]),
        (("no_cutting", "stalled"), [True, True]),
        (("no_cutting", "no_cutting", "no_stroke"), [True, True, True]),
        (("moving", "no_stroke"), [True, True]),
        (("cutting without a force", "no_stroke"), [True, False]),
    ],
)
def test_a_piece_counts_unless_only_others_cut(both, statuses, expected):
    cut = both[0].processed
    kinds = {
        "cutting": cut,
        "cutting without a force": replace(cut, folded={}, cutting_force=None),
        "stalled in the wood": replace(cut, status="stalled"),
    }
    air = replace(cut, cutting_force=None)
    assert which_count([kinds.get(one) or replace(air, status=one) for one in statuses]) == expected


def test_the_fitted_model_is_drawn_at_the_voltage_of_all_pieces(tmp_path):
    """A battery so small that its voltage falls from piece to piece; the one that is drawn is the first."""
    small = {"capacity_ah": 0.025, "beta": 0.9}
    made = integrated(tmp_path, np.full(500, K_FC), seconds=SECONDS, of_piece_s=2.0, **small)
    fit, _ = fit_trial(made.trial)
    cycle = fitted_cycle(made.trial, fit)
    measured = made.trial.processed.folded["motor_current_a"].mean
    assert cycle["motor_current_a"].mean() == pytest.approx(measured.mean(), rel=0.01)


def test_only_an_incomplete_recording_is_called_so_and_once(both, tmp_path):
    whole, joined = (one.processed for one in both)
    assert joined.warnings[:-1] == whole.warnings == ()
    lost = Event(kind="interrupted", time_s=7.0, text="no instrument sent data for 5 s")
    left = replace(read_recording(both[0].recording.path), is_complete=False, events=(lost,))
    path = write_recording(left, tmp_path / "left.mcap")
    assert in_pieces(path, seconds=2.0).processed.warnings[:-1] == left.interruptions


def test_the_scatter_is_that_of_all_strokes_about_their_common_mean(both):
    """Twice the same piece with its mean shifted by d: the variance grows by d²/4, less the divisor."""
    piece = both[0].processed
    force = piece.folded["force_n"]
    n, shift = force.n_cycles, 3.0
    shifted = replace(piece, folded={**piece.folded, "force_n": replace(force, mean=force.mean + shift)})
    joined = join_processed([piece, shifted], both[0].loaded.config).folded["force_n"]
    expected = (2 * (n - 1) * force.std**2 + 2 * n * (shift / 2) ** 2) / (2 * n - 1)
    assert np.allclose(joined.std**2, expected)
    assert np.allclose(joined.mean, force.mean + shift / 2)
    assert joined.n_cycles == 2 * n


def test_what_every_piece_says_is_said_once(both):
    pieces = [replace(both[0].processed, warnings=(f"{k} spikes were left out",)) for k in (3, 5)]
    said = join_processed(pieces, both[0].loaded.config).warnings
    assert said == ("3 spikes were left out (so or alike in 2 of 2 pieces)",)


def test_impacts_of_all_pieces_are_added_up(both):
    piece = both[0].processed
    pieces = [replace(piece, quality=tuple(replace(q, n_impacts=n) for q in piece.quality)) for n in (3, 4)]
    assert {q.n_impacts for q in join_processed(pieces, both[0].loaded.config).quality} == {7}
