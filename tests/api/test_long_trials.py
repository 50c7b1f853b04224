"""A long recording gives piece by piece what it gives whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sawbench
from sawbench.analysis import evaluate, load_and_process
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.long_trials import OUTLINE_RATE_HZ, process_long
from sawbench.processing.joined import join_processed
from sawbench.storage.reader import write_recording

pytestmark = pytest.mark.pipeline

RATE_HZ, SECONDS = 1000.0, 12.0


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
    return load_and_process(path, None), process_long(path, None, path=str(path), sha256="s", n_samples=10_000)


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
