"""The Rerun adapter: what reaches the file, and that no viewer can hurt a recording."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.errors import InputError, UntrustedResult, WritingError
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import CrankAngle, Phase, ProcessedTrial
from sawbench.bench.recording import Event, Gap, Recording, SampleBlock, Signal, Trial
from sawbench.visualization.layout import series_of, trial_markdown
from sawbench.visualization.replay import view_recording
from sawbench.visualization.rerun_view import LiveView
from sawbench.visualization.viewer import ViewerProcess, viewer_environment

from tests.rigs.rerun_picture import take_screenshot
from tests.rigs.rrd import joined, read_rrd, times_and_texts

pytestmark = pytest.mark.unit

TRIAL = Trial(trial_id="oak-01", material="oak", duty=0.4375, source="simulated bench", notes="a | b")


def block(channel="force_n", unit="N", n=500, first_index=0, rate_hz=5000.0, values=None):
    index = first_index + np.arange(n)
    return SampleBlock(
        device="cell",
        channel=channel,
        unit=unit,
        first_index=first_index,
        time_s=index / rate_hz,
        values=np.sin(index / 50.0) if values is None else values,
    )


def make_recording():
    time_s = np.arange(5000) / 5000.0
    angle = 2.0 * np.pi * 12.0 * time_s
    force = Signal(
        channel="force_n",
        unit="N",
        time_s=np.delete(time_s, slice(2000, 2500)),
        values=np.delete(200.0 * np.clip(-np.sin(angle), 0.0, None), slice(2000, 2500)),
        gaps=(Gap(start_s=time_s[1999], end_s=time_s[2500], n_missing=500, reason="unplugged"),),
    )
    displacement = Signal(channel="displacement_mm", unit="mm", time_s=time_s, values=10 - 10 * np.cos(angle))
    other = Signal(channel="bearing_temperature", unit="K", time_s=time_s[::100], values=300 + time_s[::100])
    return Recording(
        trial=TRIAL,
        signals={s.channel: s for s in (force, displacement, other)},
        events=(Event(kind="note", time_s=0.3, text="fence touched"),),
    )


def make_processed():
    angle = (np.arange(256) + 0.5) * 2.0 * np.pi / 256
    mean = 200.0 * np.clip(-np.sin(angle), 0.0, None) + 3.0
    measured, cutting = (
        FoldedCycle(
            channel="force_n",
            unit="N",
            angle_rad=angle,
            mean=values,
            std=np.ones(256),
            count=np.full(256, 12),
            n_cycles=12,
        )
        for values in (mean, np.where(angle > np.pi, mean, 0.0))
    )
    return ProcessedTrial(
        trial=TRIAL,
        status="cutting",
        period=None,
        angle=None,
        phases=(),
        folded={"force_n": measured},
        cutting_force=cutting,
        removed=None,
        peak_force_n=203.0,
        peak_force_std_n=0.5,
        warnings=("force_n has one gap",),
    )


def test_live_file_holds_every_peak_and_breaks_at_lost_samples(tmp_path):
    values = np.zeros(5000)
    values[1234], values[4321] = 287.0, -40.0
    path = tmp_path / "live.rrd"
    view = LiveView(TRIAL, show="none", save_path=path)
    view(block(n=5000, values=values))
    view(block(n=500, first_index=6000))
    view(Event(kind="note", time_s=0.5, text="fence touched"))
    view.close()
    assert (view.is_dead, view.n_dropped) == (False, 0)
    found = read_rrd(path)
    time_s, shown = joined(found, "signals/force_n")
    assert np.nanmax(shown) == 287.0
    assert np.nanmin(shown) == -40.0
    assert time_s[np.nanargmax(shown)] == pytest.approx(1234 / 5000.0, abs=1e-8)
    assert len(shown) < 0.3 * 5500
    lost = np.flatnonzero(np.isnan(shown))
    assert len(lost) == 1
    assert 1.0 < time_s[lost[0]] < 1.2


def test_live_view_finds_the_stroke_rate_itself(tmp_path):
    path = tmp_path / "live.rrd"
    view = LiveView(show="none", save_path=path)
    for first in range(0, 10_000, 250):
        at_s = (first + np.arange(250)) / 5000.0
        values = 10.0 - 10.0 * np.cos(2 * np.pi * 12.5 * at_s)
        view(block("displacement_mm", "mm", 250, first, values=values))
    view.close()
    rates = joined(read_rrd(path), "signals/stroke_rate_hz")[1]
    assert len(rates) >= 23
    np.testing.assert_allclose(rates, 12.5, rtol=2e-3)


def test_an_existing_file_is_not_overwritten(tmp_path):
    path = tmp_path / "live.rrd"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        LiveView(show="none", save_path=path)
    with pytest.raises(InputError, match="exists already"):
        view_recording(make_recording(), save_path=path, spawn=False)
    assert path.read_text() == "precious"
    with pytest.raises(InputError, match="folder does not exist"):
        LiveView(show="none", save_path=tmp_path / "nowhere" / "live.rrd")


def test_a_full_disk_leaves_no_half_a_view_and_says_where(tmp_path, monkeypatch):
    def full(*_):
        raise RuntimeError("Failed to encode LogMsg: Failed to write: No space left on device")

    monkeypatch.setattr("sawbench.visualization.replay._fill", full)
    path = tmp_path / "replay.rrd"
    with pytest.raises(WritingError, match=r"replay\.rrd: cannot be written: .*No space left") as caught:
        view_recording(make_recording(), save_path=path, spawn=False)
    assert caught.value.exit_code == 1 and not path.exists()


def test_a_viewer_that_cannot_start_is_a_reason_not_an_error(tmp_path):
    def broken(url):
        raise FileNotFoundError("no rerun here")

    path = tmp_path / "live.rrd"
    view = LiveView(show="spawn", save_path=path, start_viewer=broken)
    view(block())
    view.close()
    assert view.is_dead
    assert "no rerun here" in view.dead_reason
    assert len(joined(read_rrd(path), "signals/force_n")[1])


@pytest.mark.skipif(os.name != "posix", reason="kills a process group")
def test_a_killed_viewer_leaves_the_view_and_the_file_going(tmp_path):
    path = tmp_path / "live.rrd"
    view = LiveView(TRIAL, save_path=path, start_viewer=lambda url: ViewerProcess(connect_to=url, is_headless=True))
    assert view.url is not None
    assert view.url.startswith("rerun+http://127.0.0.1:")
    view(block(first_index=0))
    assert view.viewer_pid is not None
    os.killpg(view.viewer_pid, signal.SIGKILL)
    # On a busy machine it takes a while to be gone; it is not reaped here.
    os.waitid(os.P_PID, view.viewer_pid, os.WEXITED | os.WNOWAIT)
    for k in range(1, 41):
        view(block(first_index=500 * k))
    view.close()
    view.close()
    assert view.is_dead
    assert view.dead_reason.startswith("the viewer")
    assert view.n_dropped == 0
    assert joined(read_rrd(path), "signals/force_n")[0][-1] == pytest.approx((500 * 41 - 1) / 5000.0, abs=2e-3)


def test_a_worker_that_hangs_drops_samples_and_returns():
    is_stuck, release = threading.Event(), threading.Event()

    def hang():
        is_stuck.set()
        release.wait()

    view = LiveView(show="none")
    view._send_pending = hang  # the place where rerun would block
    assert is_stuck.wait(10.0)
    for k in range(12_000):
        view(block(n=1, first_index=k))
    assert view.n_dropped > 0
    view.close(timeout_s=0.05)
    assert "does not accept" in view.dead_reason
    release.set()


def test_replay_writes_every_sample_and_breaks_the_line_in_a_gap(tmp_path):
    recording, path = make_recording(), tmp_path / "replay.rrd"
    assert view_recording(recording, save_path=path, spawn=False, processed=make_processed()) is None
    found = read_rrd(path)
    time_s, values = joined(found, "signals/force_n")
    lost = np.flatnonzero(np.isnan(values))
    assert len(lost) == 1
    assert 0.4 < time_s[lost[0]] < 0.5
    np.testing.assert_array_equal(np.delete(values, lost), recording.signals["force_n"].values)
    assert len(joined(found, "signals/bearing_temperature")[1]) == 50
    rates = joined(found, "signals/stroke_rate_hz")[1]
    np.testing.assert_allclose(rates[np.isfinite(rates)], 12.0, rtol=2e-3)


def test_text_panel_says_simulated_and_escapes_notes():
    text = trial_markdown(TRIAL, make_processed())
    assert "not a measurement" in text
    assert r"a \| b" in text
    assert "203.0 ± 0.5 N" in text
    assert "force\\_n has one gap" in text


def test_analytics_are_off_and_the_servers_stay_local():
    environment = viewer_environment()
    assert environment["CI"]
    assert "FORCE_RERUN_ANALYTICS" not in environment


def test_importing_the_package_does_not_import_rerun():
    code = "import sys, visualization; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_screenshot_of_the_layout(tmp_path):
    path = tmp_path / "replay.rrd"
    view_recording(make_recording(), save_path=path, spawn=False, processed=make_processed())
    try:
        picture = take_screenshot(path, tmp_path / "view.png", width=1200, height=800)
    except UntrustedResult as error:
        pytest.skip(f"no graphics for a headless viewer: {error}")
    from matplotlib.image import imread

    pixels = (255 * imread(picture)[..., :3]).round().astype(int)
    assert pixels.shape == (800, 1200, 3)
    left = pixels[:, :600]
    is_force = (left[..., 0] > 180) & (left[..., 1] < 140) & (left[..., 2] < 90)
    is_displacement = (left[..., 2] > 180) & (left[..., 0] < 140)
    assert is_force.sum() > 300
    assert is_displacement.sum() > 300


def test_live_view_shows_the_cutting_estimate_with_its_bounds(tmp_path):
    path = tmp_path / "live.rrd"
    view = LiveView(TRIAL, show="none", save_path=path, has_estimate=True)
    view.cutting_estimate(1.0, 240.0, 6.0, 900.0, 30.0)
    view.cutting_estimate(1.1, 241.0, 5.0)
    view.close()
    assert not view.is_dead
    found = read_rrd(path)
    np.testing.assert_array_equal(joined(found, "signals/k_fc_n_s_per_m")[1], [240.0, 241.0])
    np.testing.assert_array_equal(joined(found, "signals/k_fc_n_s_per_m/lower")[1], [234.0, 236.0])
    np.testing.assert_array_equal(joined(found, "signals/k_fc_n_s_per_m/upper")[1], [246.0, 246.0])
    np.testing.assert_array_equal(joined(found, "signals/remaining_runtime_s")[1], [900.0])
    np.testing.assert_array_equal(joined(found, "signals/remaining_runtime_s/lower")[1], [870.0])
    np.testing.assert_array_equal(joined(found, "signals/remaining_runtime_s/upper")[1], [930.0])


def with_angle(processed):
    time_s = np.arange(5000) / 5000.0
    angle = CrankAngle(
        time_s=time_s, angle_rad=2.0 * np.pi * 12.0 * time_s, speed_rad_s=np.full(5000, 75.4),
        angle_std_rad=np.full(5000, 1e-3), radius_m=0.01, source="displacement_mm", is_absolute=True,
    )  # fmt: skip
    return replace(processed, angle=angle, phases=(Phase(kind="running", start_s=0.25, end_s=1.0),))


def test_the_fitted_model_lies_over_the_measurement_while_the_saw_runs(tmp_path):
    path, turn = tmp_path / "replay.rrd", np.linspace(0.0, 2.0 * np.pi, 200)
    # Rerun draws lines in the order of their paths; a path below another comes before it.
    assert series_of("force_n").simulated_path > series_of("force_n").path
    assert not series_of("force_n").simulated_path.startswith("signals/force_n/")
    model = {"angle_rad": turn, "force_n": np.clip(-180.0 * np.sin(turn), 0.0, None)}
    view_recording(make_recording(), save_path=path, spawn=False, processed=with_angle(make_processed()), model=model)
    time_s, values = joined(read_rrd(path), "signals/force_n_simulated")
    is_shown = np.isfinite(values)
    assert time_s[is_shown].min() == pytest.approx(0.25, abs=2e-3)
    expected = np.clip(-180.0 * np.sin(2.0 * np.pi * 12.0 * time_s[is_shown]), 0.0, None)
    np.testing.assert_allclose(values[is_shown], expected, atol=3.0)


def test_crank_and_folded_cycle_move_with_the_time(tmp_path):
    path = tmp_path / "replay.rrd"
    view_recording(make_recording(), save_path=path, spawn=False, processed=with_angle(make_processed()))
    times, _ = times_and_texts(path)
    # 12 strokes: the whole mean at 0, then a step a stroke.
    np.testing.assert_allclose(sorted(set(times["cycle/measured"]))[:12], np.arange(12) / 12.0, atol=1e-3)
    for part in ("crank", "link", "blade"):
        assert len(times[f"mechanism/{part}"]) > 12 * 40
        assert min(times[f"mechanism/{part}"]) == 0.0


def test_a_long_event_is_told_whole(tmp_path):
    path, text = tmp_path / "live.rrd", "word " * 100 + "end"
    view = LiveView(TRIAL, show="none", save_path=path)
    view(Event(kind="note", time_s=0.5, text=text))
    view.close()
    # The view shows one line of a text: each line is a text of its own.
    bodies = times_and_texts(path)[1]
    assert max(map(len, bodies)) <= 160
    assert not any("\n" in body for body in bodies)
    assert " ".join(" ".join(bodies).split()).endswith(text)
