"""The recorder with scripted devices: time is what the script says, threads are real."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices.device import Chunk, Stream, StreamChannel
from sawbench.acquisition.observers import ObserverFeed
from sawbench.acquisition.recorder import RecorderLimits, record
from sawbench.bench.errors import DeviceError, InputError
from sawbench.bench.recording import Event, SampleBlock

pytestmark = pytest.mark.unit

RATE_HZ = 1000.0
# Only the limits under test are short. A reader waits until its last read is taken: however busy the machine,
# the scripted time runs no further ahead of the recorder than two reads.
PATIENT = RecorderLimits(first_sample_s=1e6, settle_s=1e6, silence_s=1e6, all_lost_s=1e6, grace_s=1e6, queue_length=1)


class Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


class Scripted:
    """Each read is 10 ms and 10 samples; `at` maps the number of a read to what happens instead.

    Reads are counted once the recording has begun: how many the clock needs to settle is not the script's matter.
    """

    def __init__(
        self,
        name="cell",
        *,
        channel="force_n",
        at=None,
        refuse_opening=0,
        clock=None,
        valid=(-1e9, 1e9),
        has_begun=False,
    ):
        self.name, self.port = name, f"port of {name}"
        self.clock = clock or Clock()
        self.channel = StreamChannel(
            name=channel, unit="N", calibration=Calibration(scale=2.0, source="test"), valid_range=valid
        )
        self.at = defaultdict(lambda: None, at or {}) if not isinstance(at, defaultdict) else at
        self.refuse_opening = refuse_opening
        self.n_discarded_bytes = 0
        self.has_begun = has_begun
        self.n_reads = self.n_samples = self.n_opened = 0
        self.is_open = False

    @property
    def streams(self):
        return (Stream(name="frames", rate_hz=RATE_HZ, channels=(self.channel,)),)

    def open(self):
        self.n_opened += 1
        if self.n_opened > 1 and self.refuse_opening:
            self.refuse_opening -= 1
            raise DeviceError("still unplugged")
        self.is_open = True

    def start(self):
        assert self.is_open

    def read(self):
        assert self.is_open
        self.n_reads += self.has_begun
        self.clock.now_s += 0.01
        what = self.at[self.n_reads] if self.has_begun else None
        if what is not None:
            return what(self)
        return [self.chunk()]

    def chunk(self, value=None, **options):
        first, self.n_samples = self.n_samples, self.n_samples + 10
        raw = np.arange(first, first + 10, dtype=float)[:, None] if value is None else np.full((10, 1), value)
        return Chunk(stream="frames", raw=raw, arrival_s=np.array([self.clock.now_s]), **options)

    def stop(self):
        self.is_open = False

    def describe(self):
        return {"model": "scripted"}


class Writer:
    def __init__(self, at=None, do=None):
        self.items = []
        self.devices = []
        self.at, self.do = at, do
        self.closed_as = None

    def write_block(self, block):
        if len(self.items) == self.at:
            self.at = None
            self.do()
        self.items.append(block)

    def write_event(self, event):
        for device in self.devices:
            device.has_begun = True
        self.items.append(event)

    def close(self, *, provenance, is_complete):
        self.closed_as = is_complete

    def blocks(self):
        return [x for x in self.items if isinstance(x, SampleBlock)]

    def events(self, kind):
        return [x for x in self.items if isinstance(x, Event) and x.kind == kind]


def run(device, writer=None, **options):
    writer = writer or Writer()
    writer.devices.append(device)
    options.setdefault("limits", PATIENT)
    summary = record([device], writer, clock=device.clock, **options)
    return summary, writer


def test_as_many_samples_as_asked_with_one_index_and_calibrated():
    device = Scripted()
    summary, writer = run(device, seconds=2.0)
    blocks = writer.blocks()
    index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in blocks])
    time_s = np.concatenate([b.time_s for b in blocks])
    assert len(index) == pytest.approx(2000, abs=1)
    assert np.all(np.diff(index) == 1)
    assert time_s[0] >= 0
    assert time_s[-1] < 2.0
    assert np.diff(time_s) == pytest.approx(np.full(len(time_s) - 1, 1e-3), rel=1e-3)
    assert all(np.array_equal(b.values, 2.0 * b.raw) for b in blocks)
    (channel,) = summary.channels
    assert (channel.n_samples, channel.n_gaps, channel.n_missing) == (len(index), 0, 0)
    assert channel.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert summary.is_complete
    assert summary.end_reason == "2 s recorded"
    assert "source: test" in summary.provenance["calibration force_n"]
    assert "alignment" in " ".join(summary.provenance)
    assert not device.is_open


def test_the_writer_is_made_when_start_and_alignment_are_known():
    starts = []
    writer = Writer()

    def make(start):
        starts.append(start)
        return writer

    summary = record([device := Scripted()], make, seconds=0.5, clock=device.clock, limits=PATIENT)
    assert starts[0].started_at == summary.started_at
    assert "lower envelope" in starts[0].provenance["alignment cell frames"]
    assert len(writer.blocks()) > 0


def unplugged(device):
    """Half a second passes before the plug is back."""
    device.clock.now_s += 0.5
    raise DeviceError("the link broke")


def test_unplugged_and_back_goes_on_in_the_same_recording():
    device = Scripted(at={30: unplugged}, refuse_opening=2)
    summary, writer = run(device, seconds=20.0)
    (channel,) = summary.channels
    (gap,) = writer.events("gap")
    assert device.n_opened == 4
    assert summary.devices[0].n_reconnects == 1
    assert channel.n_gaps == 1
    assert channel.n_missing == pytest.approx(510, abs=15)
    assert channel.n_samples + channel.n_missing == pytest.approx(20_000, abs=2)
    assert "the link broke" in gap.text
    assert [e.text.split()[1] for e in writer.events("device")][1:] == ["lost:", "is"]
    index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in writer.blocks()])
    time_s = np.concatenate([b.time_s for b in writer.blocks()])
    assert np.all(np.diff(time_s) > 0)
    assert np.diff(index).max() == channel.n_missing + 1


def test_a_driver_that_fails_while_the_link_comes_back_is_tried_again_and_said_once():
    class Confused(Scripted):
        def start(self):
            if 1 < self.n_opened < 4:
                raise ZeroDivisionError("nonsense in the start dialogue")

    device = Confused(at={30: unplugged})
    summary, writer = run(device, seconds=5.0)
    assert summary.devices[0].n_reconnects == 1
    assert device.n_opened == 4
    assert summary.is_complete
    said = [e.text for e in writer.events("device") if e.text.startswith("link lost: driver failed")]
    assert said == ["link lost: driver failed: ZeroDivisionError('nonsense in the start dialogue')"]


def test_a_link_that_comes_back_with_another_instrument_is_not_believed():
    class Exchanged(Scripted):
        def describe(self):
            # The second and third time it is opened, another bench is on the plug.
            return {"model": "scripted", "serial_number": "666" if self.n_opened in {2, 3} else "42"}

    summary, writer = run(Exchanged(at={30: unplugged}), seconds=20.0)
    said = [e.text for e in writer.events("device") if e.text.startswith("link lost: another instrument")]
    assert len(said) == 1
    assert "666" in said[0] and "42" in said[0]
    assert summary.devices[0].n_reconnects == 1
    assert summary.channels[0].n_gaps == 1


def test_a_counted_loss_is_one_gap_event():
    device = Scripted(at={30: lambda d: [d.chunk(n_lost=4)]})
    summary, writer = run(device, seconds=5.0)
    (gap,) = writer.events("gap")
    assert "4 samples missing" in gap.text
    assert summary.channels[0].n_missing == 4
    assert (gap.device, gap.channel) == ("cell", "force_n")


def test_values_no_sensor_can_mean_become_a_gap():
    device = Scripted(at={30: lambda d: [d.chunk(value=1e30)]}, valid=(-1.0, 1e6))
    summary, writer = run(device, seconds=5.0)
    (gap,) = writer.events("gap")
    assert "outside the valid range of the instrument" in gap.text
    assert summary.channels[0].n_missing == 10
    assert max(b.values.max() for b in writer.blocks()) < 1e6


def test_samples_out_of_range_do_not_make_the_rate_look_low():
    saturated = dict.fromkeys(range(30, 300, 2), lambda device: [device.chunk(value=1e30)])
    summary, _ = run(Scripted(at=saturated, valid=(-1.0, 1e6)), seconds=4.0)
    (channel,) = summary.channels
    assert channel.n_missing > 0.2 * channel.n_samples
    assert channel.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)


def test_stop_event_ends_it():
    stop = threading.Event()
    summary, writer = run(Scripted(), stop=stop, status=lambda s: s.elapsed_s > 1.0 and stop.set())
    assert summary.end_reason == "stopped by the operator"
    assert summary.is_complete
    assert writer.events("stop")


def test_ctrl_c_in_the_middle_of_writing_ends_it_and_loses_nothing():
    writer = Writer(at=8, do=lambda: signal.raise_signal(signal.SIGINT))
    summary, _ = run(Scripted(), writer)
    assert "Ctrl-C" in summary.end_reason
    index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in writer.blocks()])
    assert np.all(np.diff(index) == 1)
    assert len(index) == summary.channels[0].n_samples
    assert writer.events("stop")
    assert writer.closed_as is True


def test_ctrl_c_while_the_file_is_finished_is_raised_when_it_is():
    class Finishing(Writer):
        def close(self, **how):
            signal.raise_signal(signal.SIGINT)
            super().close(**how)

    writer = Finishing()
    with pytest.raises(KeyboardInterrupt, match="Ctrl-C"):
        run(Scripted(), writer, seconds=1.0)
    assert writer.closed_as is True


def test_a_writer_that_fails_ends_it_and_frees_the_devices():
    def full():
        raise OSError("disk full")

    device = Scripted()
    with pytest.raises(OSError, match="disk full"):
        run(device, Writer(at=5, do=full), seconds=10.0)
    assert not device.is_open


def test_status_counts_up_and_its_failure_does_no_harm():
    seen = []

    def status(snapshot):
        seen.append(snapshot)
        if len(seen) == 3:
            raise RuntimeError("terminal gone")

    # After every message: by the clock, which the reading thread drives, it may be due only once or twice.
    summary, writer = run(Scripted(), seconds=5.0, status=status, limits=replace(PATIENT, status_every_s=0.0))
    counts = [s.channels[0].n_samples for s in seen]
    assert len(seen) == 3
    assert counts == sorted(counts)
    assert any("terminal gone" in e.text for e in writer.events("warning"))
    assert summary.channels[0].n_samples == pytest.approx(5000, abs=1)


def test_an_observer_that_raises_is_removed_and_noted():
    calls = []

    def observer(item):
        calls.append(item)
        raise RuntimeError("viewer died")

    good = []
    summary, writer = run(Scripted(), seconds=3.0, observers=[observer, good.append])
    assert len(calls) == 1
    assert len(good) > 10
    assert summary.channels[0].n_samples == pytest.approx(3000, abs=1)
    assert all("viewer died" in e.text for e in writer.events("warning"))


def test_an_observer_that_hangs_costs_only_itself():
    release = threading.Event()
    feed = ObserverFeed([lambda _: release.wait()], most_samples=200)
    for k in range(10):
        feed.offer(Event(kind="note", time_s=float(k), text="x"))
    assert feed.n_dropped >= 7
    feed.close()
    release.set()


def test_nobody_delivers_any_more():
    def gone(device):
        device.clock.now_s += 0.001
        raise DeviceError("the link broke")

    limits = replace(PATIENT, all_lost_s=0.0)
    device = Scripted(at=dict.fromkeys(range(30, 100_000), gone), refuse_opening=10**6)
    device.clock = Ticking(device.clock)
    summary, writer = run(device, limits=limits)
    assert not summary.is_complete
    assert "no instrument sent data" in summary.end_reason
    assert writer.events("interrupted")


class Ticking:
    """A clock that also goes on while nobody reads."""

    def __init__(self, inner):
        self._inner = inner

    @property
    def now_s(self):
        return self._inner.now_s

    @now_s.setter
    def now_s(self, value):
        self._inner.now_s = value

    def __call__(self):
        self._inner.now_s += 1e-6
        return self._inner.now_s


def silent(device):
    device.clock.now_s += 0.2
    return []


def test_silence_at_the_start_names_device_and_port():
    device = Scripted(at=defaultdict(lambda: silent), has_begun=True)
    with pytest.raises(DeviceError, match="sent no sample of frames") as caught:
        run(device, limits=RecorderLimits(silence_s=1e9, queue_length=1), seconds=1.0)
    assert "cell on port of cell" in str(caught.value)
    assert not device.is_open


class Paced(Scripted):
    """Samples at a rate of its own, by the time of the clock, until `ends_s`; a read may take `step_s`."""

    def __init__(self, rate_hz, ends_s=np.inf, step_s=0.0, **options):
        super().__init__(f"{rate_hz:g} Hz", has_begun=True, **options)
        self.rate_hz, self.ends_s, self.step_s = rate_hz, ends_s, step_s

    @property
    def streams(self):
        return (Stream(name="frames", rate_hz=self.rate_hz, channels=(self.channel,)),)

    def start(self):
        self.start_s, self.n_samples = self.clock.now_s, 0

    def read(self):
        self.clock.now_s += self.step_s
        now_s = min(self.clock.now_s, self.ends_s)
        n = int((now_s - self.start_s) * self.rate_hz + 1e-6) - self.n_samples
        self.n_samples += n
        if not n:
            return []
        return [Chunk(stream="frames", raw=np.full((n, 1), 21.0), arrival_s=np.array([self.clock.now_s]))]


def paced(*devices, seconds):
    """Record in turn, in 50 ms of the devices' clock a round."""
    clock, writer = devices[0].clock, Writer()

    def pass_time():
        clock.now_s += 0.05

    return record(devices, writer, seconds=seconds, clock=clock, between_rounds=pass_time), writer


@pytest.mark.parametrize("rate_hz", [2.0, 1.0, 0.5, 0.2])
def test_a_slow_instrument_has_the_time_that_its_samples_take(rate_hz):
    clock = Clock()
    slow = Paced(rate_hz, clock=clock, channel="board_temp_degc")
    summary, writer = paced(Paced(1000.0, clock=clock), slow, seconds=20.0)
    assert summary.is_complete and not writer.events("gap") and not writer.events("warning")
    assert {c.channel: c.n_samples for c in summary.channels}["board_temp_degc"] == round(20.0 * rate_hz)


@pytest.mark.parametrize(("ends_s", "words"), [(0.0, "sent no sample of frames within 4 s"), (5.0, "within 18 s")])
def test_a_slow_instrument_that_does_not_begin_is_said_with_the_time_that_it_had(ends_s, words):
    clock = Clock()
    slow = Paced(0.5, clock=clock, ends_s=clock.now_s + ends_s, channel="board_temp_degc")
    with pytest.raises(DeviceError, match=words) as caught:
        paced(Paced(1000.0, clock=clock), slow, seconds=20.0)
    assert "0.5 Hz on port of 0.5 Hz" in str(caught.value)


def test_the_pause_between_two_samples_of_a_slow_instrument_is_no_lost_link():
    slow = Paced(0.2, step_s=0.05)
    summary, writer = run(slow, limits=replace(PATIENT, silence_s=2.5), seconds=40.0)
    assert summary.devices[0].n_reconnects == 0 and not writer.events("gap")


def test_silence_while_recording_is_a_lost_link():
    device = Scripted(at=dict.fromkeys(range(30, 60), silent))
    limits = replace(PATIENT, silence_s=2.0)
    summary, writer = run(device, limits=limits, seconds=20.0)
    assert summary.devices[0].n_reconnects >= 1
    assert any("sent nothing" in e.text for e in writer.events("device"))
    assert summary.channels[0].n_gaps == 1


def test_a_missing_device_frees_the_others():
    present, missing = Scripted("present"), Scripted("missing", channel="displacement_mm")

    def refuse():
        raise DeviceError("no such port", where="missing", remedy="plug it in")

    missing.open = refuse
    with pytest.raises(DeviceError, match="no such port"):
        record([present, missing], Writer(), clock=present.clock, seconds=1.0)
    assert not present.is_open


def test_a_wrong_rate_is_refused_at_the_start():
    device = Scripted()
    device.chunk = lambda: Chunk(stream="frames", raw=np.zeros((5, 1)), arrival_s=np.array([device.clock.now_s]))
    with pytest.raises(DeviceError, match="500 samples/s, configured are 1000"):
        run(device, seconds=1.0)


def test_a_busy_moment_at_the_start_is_no_wrong_rate():
    """The first samples come later and later, up to 0.1 s: over 0.4 s that is 20 % of the rate."""
    device = Scripted()
    n_read = 0

    def chunk(value=None, **options):
        nonlocal n_read
        n_read += 1
        made = Scripted.chunk(device, value, **options)
        late_s = min(n_read, 40) / 40 * 0.1 if n_read < 60 else 0.0
        return replace(made, arrival_s=made.arrival_s + late_s)

    device.chunk = chunk
    summary, _ = run(device, seconds=1.0)
    assert summary.channels[0].n_missing == 0


def test_a_fault_in_a_driver_is_noted_and_the_rest_goes_on():
    # The two read in turn, until one crashes; only one of them moves the time on.
    in_turn = threading.Barrier(2)

    def wait(device):
        with contextlib.suppress(threading.BrokenBarrierError):
            in_turn.wait(60.0)
        return [device.chunk()]

    def wait_and_hold_time(device):
        device.clock.now_s -= 0.01
        if len(writer.items) > 30:
            in_turn.abort()
            raise ZeroDivisionError("bug")
        return wait(device)

    writer = Writer()
    clock = Clock()
    sound = Scripted("sound", channel="displacement_mm", clock=clock, at=defaultdict(lambda: wait), has_begun=True)
    broken = Scripted("broken", clock=clock, at=defaultdict(lambda: wait_and_hold_time), has_begun=True)
    summary = record([sound, broken], writer, seconds=5.0, clock=clock, limits=PATIENT)
    by_name = {c.channel: c for c in summary.channels}
    assert any("driver failed" in e.text for e in writer.events("device"))
    assert by_name["displacement_mm"].n_samples > 0
    assert by_name["force_n"].n_gaps == 1
    # Gone for good: not complete, all that is missing counted, the rate that of what came.
    assert not summary.is_complete
    assert by_name["force_n"].n_missing + by_name["force_n"].n_samples == pytest.approx(5000, abs=5)
    assert by_name["force_n"].rate_hz == pytest.approx(RATE_HZ, rel=0.02)
    assert [loss.split(":")[0] for loss in summary.losses] == ["force_n"]


def test_wrong_usage_is_said():
    with pytest.raises(InputError, match="no instrument"):
        record([], Writer())
    with pytest.raises(InputError, match="greater than 0"):
        record([Scripted()], Writer(), seconds=0.0)
