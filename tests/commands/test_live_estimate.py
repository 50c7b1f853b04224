"""The live k_Fc against the batch fit, from stored blocks as the recorder would hand them over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sawbench.acquisition.recording_report import RecordingStatus
from sawbench.analysis import fit_trial, load_and_process, runtime_of
from sawbench.bench.recording import Event, Trial
from sawbench.commands.live_counters import LiveCounters
from sawbench.commands.live_estimate import LiveCuttingEstimate
from sawbench.inputs import config_for
from sawbench.storage.reader import iter_blocks, read_recording

pytestmark = pytest.mark.pipeline

RECORDINGS = Path(__file__).parents[2] / "recordings"
OAK, NYLON = RECORDINGS / "oak-01.mcap", RECORDINGS / "nylon-01.mcap"


def estimate_for(path, **options):
    recording = read_recording(path)
    return LiveCuttingEstimate(config_for(recording, None), recording.trial, **options)


@pytest.fixture(scope="module")
def oak_and_its_shows():
    shown = []
    live = estimate_for(OAK, show=lambda time_s, found: shown.append((time_s, found)))
    for block in iter_blocks(OAK):
        live(block)
    return live, shown


def test_agrees_with_the_batch_fit_within_its_stated_uncertainty(oak_and_its_shows):
    live, shown = oak_and_its_shows
    batch, _ = fit_trial(load_and_process(OAK, None))
    assert live.problem == ""
    difference = abs(live.latest.k_fc_n_s_per_m - batch.k_fc_n_s_per_m)
    assert difference < live.latest.std_n_s_per_m
    assert live.latest.std_n_s_per_m < 0.03 * live.latest.k_fc_n_s_per_m
    assert live.latest.remaining_s > 0
    assert live.n_changes == 0
    assert len(shown) == live.latest.n_strokes
    periods = np.diff([time_s for time_s, _ in shown])
    assert 0.07 < periods.min() < periods.max() < 0.08
    assert "N·s/m" in live.describe()
    # Nobody states the charge before a trial: the estimate begins at a full battery.
    assert "of battery runtime left if the battery was full at the start" in live.describe()


def test_known_effects_make_the_same_of_it_as_fit_and_runtime(tmp_path):
    recording = read_recording(OAK)
    config = tmp_path / "known.toml"
    shipped = (OAK.parents[1] / "bench_config.toml").read_text(encoding="utf-8")
    config.write_text(f"{shipped}\n[effects]\nguide_friction = {{ force_n = 5.1, std = 0.4 }}\n", encoding="utf-8")
    trial = load_and_process(OAK, config)
    batch, estimates = fit_trial(trial)
    live = LiveCuttingEstimate(trial.loaded, recording.trial)
    for block in iter_blocks(OAK):
        live(block)
    assert live.problem == ""
    assert abs(live.latest.k_fc_n_s_per_m - batch.k_fc_n_s_per_m) < live.latest.std_n_s_per_m
    predicted = runtime_of(trial, batch, estimates)
    passed_s = live.latest.n_strokes * 0.075
    assert abs(live.latest.remaining_s + passed_s - predicted.runtime_s) < np.hypot(
        predicted.std_s, live.latest.remaining_std_s
    )


def shifted(path, by_s, by_index):
    for block in iter_blocks(path):
        yield replace(block, time_s=block.time_s + by_s, first_index=block.first_index + by_index[block.channel])


def test_a_change_of_material_is_noticed():
    live = estimate_for(OAK)
    counts = dict.fromkeys(read_recording(OAK).signals, 0)
    for block in iter_blocks(OAK):
        live(block)
        counts[block.channel] = block.first_index + len(block.time_s)
    oak = live.latest.k_fc_n_s_per_m
    for block in shifted(NYLON, 2.0, counts):
        live(block)
    batch, _ = fit_trial(load_and_process(NYLON, None))
    assert live.n_changes == 1
    assert oak > 5 * live.latest.k_fc_n_s_per_m
    assert abs(live.latest.k_fc_n_s_per_m - batch.k_fc_n_s_per_m) < 2 * live.latest.std_n_s_per_m


def test_the_rest_before_the_trigger_zeroes_the_load_cell(oak_and_its_shows):
    live = estimate_for(OAK)
    for block in iter_blocks(OAK):
        live(replace(block, values=block.values + 40.0) if block.channel == "force_n" else block)
    assert live.latest.k_fc_n_s_per_m == pytest.approx(oak_and_its_shows[0].latest.k_fc_n_s_per_m, rel=1e-6)


def test_without_displacement_it_says_so_once(capsys):
    live = estimate_for(OAK)
    counters = LiveCounters(live)
    status = RecordingStatus(elapsed_s=0.1, channels=(), lost_devices=())
    for by_s in (0.0, 2.0):
        for block in shifted(OAK, by_s, dict.fromkeys(read_recording(OAK).signals, 0)):
            if block.channel != "displacement_mm":
                live(block)
            counters(status)
    assert live.latest is None
    assert capsys.readouterr().err.count("no live k_Fc: no displacement_mm is received") == 1


def test_trouble_ends_the_display_and_nothing_else():
    def broken(time_s, found):
        raise RuntimeError("the display fell off")

    live = estimate_for(OAK, show=broken)
    for block in iter_blocks(OAK):
        live(block)
    live(Event(kind="note", time_s=0.0, text="still there"))
    assert "the display fell off" in live.problem


def test_a_blade_in_air_has_no_live_k_fc():
    recording = read_recording(OAK)
    live = LiveCuttingEstimate(config_for(recording, None), Trial(trial_id="x", material="none", duty=0.4))
    assert live.problem == "idle run"


def test_what_the_sensors_read_is_taken_back_as_in_the_batch_fit(tmp_path):
    """The same recording, its force and current stated to read a tenth high: the k_Fc of a force a tenth smaller."""
    shipped = (OAK.parents[1] / "bench_config.toml").read_text(encoding="utf-8")
    config = tmp_path / "sensors.toml"
    config.write_text(f"{shipped}\n[sensors]\nforce_n = {{ gain = 1.1 }}\nmotor_current_a = {{ gain = 1.1 }}\n")
    trial = load_and_process(OAK, config)
    batch, _ = fit_trial(trial)
    live = LiveCuttingEstimate(trial.loaded, read_recording(OAK).trial)
    for block in iter_blocks(OAK):
        live(block)
    assert live.problem == ""
    assert abs(live.latest.k_fc_n_s_per_m - batch.k_fc_n_s_per_m) < live.latest.std_n_s_per_m
    usual, _ = fit_trial(load_and_process(OAK, None))
    assert batch.k_fc_n_s_per_m < 0.95 * usual.k_fc_n_s_per_m
