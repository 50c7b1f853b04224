"""Logged frames: formats that python-can wrote, and a real heavy-duty log whose truth is known."""

from __future__ import annotations

import gzip
import os
import re
import struct
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pytest
from sawbench.acquisition.can_logs import decode_can_log
from sawbench.bench.errors import ConfigError, InputError

pytestmark = pytest.mark.unit

ROOT = Path(__file__).parents[2]
SHARED = Path(os.environ.get("SAWBENCH_SHARED", ROOT.parent / "shared" / "data")) / "can_css_j1939"
SIGNALS = {"motor_current_a": "MotorStatus.MotorCurrent"}


def frames(n=500):
    for k in range(n):
        if 200 <= k < 230:
            continue
        data = struct.pack("<Hh", k, round(1000 * np.sin(k / 20)))
        yield can.Message(timestamp=1.7e9 + k / 1000, arbitration_id=0x100, is_extended_id=False, data=data, channel=0)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_formats(tmp_path, suffix):
    path = tmp_path / f"drive.one{suffix}"
    with can.Logger(path) as logger:
        for message in frames():
            logger.on_message_received(message)
    signal = decode_can_log(path, "jigsaw_bench.dbc", SIGNALS).signal("motor_current_a")
    k = np.delete(np.arange(500), np.s_[200:230])
    assert signal.unit == "A"
    assert signal.time_s == pytest.approx(k / 1000, abs=2e-6)
    assert signal.values == pytest.approx(0.005 * np.round(1000 * np.sin(k / 20)))
    assert [(g.n_missing, round(g.start_s, 3)) for g in signal.gaps] == [(30, 0.199)]


def test_two_senders_are_not_mixed(tmp_path):
    path = tmp_path / "two.log"
    lines = []
    for k in range(100):
        lines.append(f"({k / 100:.6f}) can0 100#{struct.pack('<Hh', k, 100).hex()}")
        if k % 3 == 0:
            lines.append(f"({k / 100 + 0.001:.6f}) can1 100#{struct.pack('<Hh', k, -100).hex()}")
    path.write_text("\n".join(lines))
    recording = decode_can_log(path, "jigsaw_bench.dbc", SIGNALS)
    assert set(recording.signal("motor_current_a").values) == {0.5}
    assert "2 senders" in recording.events[0].text
    other = decode_can_log(path, "jigsaw_bench.dbc", SIGNALS, bus="can1")
    assert set(other.signal("motor_current_a").values) == {-0.5}


def test_a_log_that_is_cut_off_gives_the_frames_before(tmp_path):
    path = tmp_path / "cut.log"
    lines = [f"({k / 100:.6f}) can0 100#{struct.pack('<Hh', k, 100).hex()}" for k in range(200)]
    path.write_text("\n".join(lines)[:-20])
    recording = decode_can_log(path, "jigsaw_bench.dbc", SIGNALS)
    assert len(recording.signal("motor_current_a").values) == 199
    assert not recording.is_complete
    (text,) = recording.interruptions
    said = "it ends at 1.98 s, what came after is lost (the log is cut off or damaged after 199 frames)"
    assert text == f"the recording is incomplete: {said}"


def test_wrong_input_is_said(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        decode_can_log(tmp_path / "none.log", "jigsaw_bench.dbc")
    text = tmp_path / "text.log"
    text.write_text("this is no candump\n")
    with pytest.raises(InputError, match="cannot be read as a CAN log"):
        decode_can_log(text, "jigsaw_bench.dbc")
    packed = tmp_path / "empty.log.gz"
    packed.write_bytes(gzip.compress(b""))
    with pytest.raises(InputError, match="no CAN frames"):
        decode_can_log(packed, "jigsaw_bench.dbc")
    other = tmp_path / "other.log"
    other.write_text("(1.0) can0 7FF#00\n")
    with pytest.raises(InputError, match="no frame of MotorStatus"):
        decode_can_log(other, "jigsaw_bench.dbc", SIGNALS)
    with pytest.raises(InputError, match="no frame that the DBC describes"):
        decode_can_log(other, "jigsaw_bench.dbc")
    with pytest.raises(ConfigError, match="no signal"):
        decode_can_log(other, "jigsaw_bench.dbc", {"motor_current_a": "MotorStatus.Speed"})


def asc(*, header="date Mon Nov 30 10:11:12.250 am 2026\nbase hex  timestamps absolute\n", stamps):
    rows = [f"{at_s:11.6f} 1  100             Rx   d 4 {k:02X} 00 64 00\n" for k, at_s in enumerate(stamps)]
    return header + "".join(rows)


def test_relative_stamps_of_an_asc_are_added_up(tmp_path):
    path = tmp_path / "relative.asc"
    step_s = np.round(0.01 + np.random.default_rng(0).uniform(-0.001, 0.001, 200), 6)
    header = "date Mon Nov 30 10:11:12 2026\nbase hex  timestamps relative\ninternal events logged\n"
    text = asc(header=header, stamps=step_s).splitlines(keepends=True)
    # What stands between two frames counts as they do: 0.25 s pass before it, and so much less before the next frame.
    text.insert(103, "   0.250000 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 1.00%\n")
    path.write_text("".join(text))
    recording = decode_can_log(path, "jigsaw_bench.dbc", {"count": "MotorStatus.SampleCounter"})
    signal = recording.signal("count")
    truth_s = np.cumsum(step_s) - step_s[0]
    truth_s[100:] += 0.25
    assert signal.values.tolist() == list(range(200))
    assert signal.time_s == pytest.approx(truth_s, abs=2e-6)
    assert recording.events == () and recording.is_complete


@pytest.mark.parametrize(
    ("date", "encoding", "started_at"),
    [
        ("Mon Nov 30 10:11:12.250 am 2026", "utf-8", datetime(2026, 11, 30, 10, 11, 12, 250000)),
        ("Mon Nov 30 12:11:12 am 2026", "utf-8", datetime(2026, 11, 30, 0, 11, 12)),
        ("Mo Nov 30 10:11:12.250 nachm. 2026", "latin-1", datetime(2026, 11, 30, 22, 11, 12, 250000)),
        ("Die Mrz 3 10:11:12 2026", "utf-8-sig", datetime(2026, 3, 3, 10, 11, 12)),
        ("Die Mär 3 10:11:12 2026", "latin-1", datetime(2026, 3, 3, 10, 11, 12)),
        ("lun. nov. 31 10:11:12 2026", "latin-1", None),
        ("2026-11-30", "latin-1", None),
    ],
)
def test_an_asc_in_any_language_and_encoding_is_read(tmp_path, date, encoding, started_at):
    path = tmp_path / "date.asc"
    header = f"date {date}\nbase hex  timestamps absolute\n// Prüfstand\nBegin Triggerblock {date}\n"
    path.write_bytes(asc(header=header, stamps=np.arange(50) / 100).encode(encoding))
    recording = decode_can_log(path, "jigsaw_bench.dbc", SIGNALS)
    assert recording.signal("motor_current_a").time_s == pytest.approx(np.arange(50) / 100, abs=1e-6)
    assert recording.trial.started_at == (started_at and started_at.astimezone(UTC))


def test_the_first_frame_behind_a_short_header_counts(tmp_path):
    path = tmp_path / "short.asc"
    path.write_text(asc(stamps=np.arange(20) / 100))
    assert len(decode_can_log(path, "jigsaw_bench.dbc", SIGNALS).signal("motor_current_a").values) == 20


@pytest.mark.parametrize("extra", ["", "  RX - -"])
def test_the_columns_of_candump_are_read(tmp_path, extra):
    # As fprint_long_canframe of can-utils writes them, with `-a` (text behind the bytes) and without.
    path = tmp_path / "columns.log"
    rows = [f" (1700000000.{k:02d}0000)  can0{extra}  100   [4]  {k:02X} 00 64 00   '..d.'" for k in range(50)]
    rows.insert(7, f" (1700000000.065000)  can0{extra}  100   [0]  remote request")
    rows.insert(7, f" (1700000000.065000)  can0{extra}  00000100   [4]  FF 00 00 00")
    rows.insert(7, f" (1700000000.065000)  can0{extra}  100  [04]  FF 00 C8 00")
    path.write_text("\n".join(rows))
    recording = decode_can_log(path, "jigsaw_bench.dbc", {"count": "MotorStatus.SampleCounter"})
    assert recording.signal("count").values.tolist() == [*range(7), 255, *range(7, 50)]
    assert recording.trial.started_at == datetime.fromtimestamp(1.7e9, UTC)


@pytest.mark.parametrize("row", [" (000.010000)  can0  100   [4]  00 00 64 00", "  can0  100   [4]  00 00 64 00"])
def test_candump_without_absolute_stamps_is_refused_with_the_reason(tmp_path, row):
    path = tmp_path / "delta.log"
    path.write_text(f"{row}\n" * 20)
    with pytest.raises(InputError, match=r"line 1 is .*expected \(SECONDS\)(.|\n)*candump -ta"):
        decode_can_log(path, "jigsaw_bench.dbc", SIGNALS)


DBC = 'VERSION ""\nNS_ :\n SG_MUL_VAL_\nBS_:\nBU_: A\n'


def test_a_signal_behind_two_multiplexers_is_read_where_both_select_it(tmp_path):
    """Truth from the frames: X is there on page 1 of P with page 2 of Q; on page 0 of P the place of Q is part of T."""
    dbc, log = tmp_path / "nested.dbc", tmp_path / "nested.log"
    dbc.write_text(
        DBC + "BO_ 100 M: 8 A\n"
        ' SG_ P M : 0|8@1+ (1,0) [0|0] "" A\n SG_ Q m1M : 8|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ X m2 : 16|16@1+ (0.1,0) [0|0] "A" A\n SG_ T m0 : 8|16@1+ (1,0) [0|0] "" A\n'
        "SG_MUL_VAL_ 100 Q P 1-1;\nSG_MUL_VAL_ 100 X Q 2-2;\nSG_MUL_VAL_ 100 T P 0-0;\n"
    )
    payloads = [(1, 2, 100), (0, 2, 5000), (1, 3, 7000), (1, 2, 200)]
    rows = [f"(1700000000.{k:02d}0000) can0 064#{struct.pack('<BBH', *p).hex()}" for k, p in enumerate(payloads)]
    log.write_text("\n".join(rows))
    recording = decode_can_log(log, dbc)
    assert recording.signal("M.X").values == pytest.approx([10.0, 20.0])
    assert recording.signal("M.Q").values.tolist() == [2, 3, 2]
    assert recording.signal("M.T").values.tolist() == [2 + 256 * (5000 % 256)]


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_frames_of_can_fd_are_decoded_where_the_dbc_is_as_long_and_counted_where_not(tmp_path, suffix):
    dbc, log = tmp_path / "fd.dbc", tmp_path / f"fd{suffix}"
    dbc.write_text(
        DBC + 'BO_ 100 M: 8 A\n SG_ S : 0|16@1+ (1,0) [0|0] "A" A\n'
        'BO_ 101 F: 48 A\n SG_ V : 0|16@1+ (1,0) [0|0] "V" A\n SG_ I : 364|16@1- (0.5,0) [0|0] "A" A\n'
        ' SG_ B : 295|16@0- (1,0) [0|0] "" A\n SG_ Text : 16|128@1+ (1,0) [0|0] "" A\n'
    )
    numbers = np.arange(-25, 25)
    with can.Logger(log) as logger:
        for k, number in enumerate(numbers.tolist()):
            # Bits 364 to 379 in Intel order are the middle of bytes 45 to 47; 295 is the first bit of byte 36.
            first, second = struct.pack("<H34x", k), struct.pack(">h7x", -3 * number)
            long = first + second + ((number & 0xFFFF) << 4).to_bytes(3, "little")
            for identifier, data in ((100, struct.pack("<H", k)), (101, long), (102, bytes(12)), (100, bytes(16))):
                logger.on_message_received(
                    can.Message(
                        timestamp=1.7e9 + k / 100 + (identifier - 100 + len(data) // 16) / 1000,
                        arbitration_id=identifier,
                        is_extended_id=False,
                        is_fd=len(data) > 8,
                        data=data,
                        channel=0,
                    )
                )
    recording = decode_can_log(log, dbc)
    assert recording.signal("M.S").values.tolist() == list(range(50))
    assert recording.signal("F.V").values.tolist() == list(range(50))
    assert recording.signal("F.I").values.tolist() == (0.5 * numbers).tolist()
    assert recording.signal("F.B").values.tolist() == (-3 * numbers).tolist()
    (event,) = recording.events
    assert event.kind == "warning" and event.text.startswith("100 frames of CAN FD with more than 8 bytes left out")


def test_a_clock_that_was_set_back_is_said_and_jitter_is_not(tmp_path):
    path = tmp_path / "back.log"
    truth_s = np.arange(200) / 100
    jitter_s = np.random.default_rng(1).uniform(-0.006, 0.006, 200)

    def said(stamps_s):
        rows = [f"({1.7e9 + at_s:.6f}) can0 100#{struct.pack('<Hh', k, 100).hex()}" for k, at_s in enumerate(stamps_s)]
        path.write_text("\n".join(rows))
        return decode_can_log(path, "jigsaw_bench.dbc", SIGNALS).events

    assert (np.diff(truth_s + jitter_s) < 0).any()
    assert said(truth_s + jitter_s) == ()
    for back_s in (0.5, 3600.0):
        (event,) = [e for e in said(np.where(truth_s < 1.0, truth_s, truth_s - back_s + 0.004)) if "go back" in e.text]
        assert event.kind == "warning"
        assert float(re.search(r"by up to (\S+) s", event.text)[1]) == pytest.approx(back_s - 0.014, abs=1e-3)


@pytest.mark.skipif(not SHARED.exists(), reason="the real log is not on this machine")
def test_idle_of_a_real_engine():
    """Truth from the data set's README: 12719 frames at 10.0 ms, mean 650.05 rpm, 646.5..653.75 rpm."""
    log = next(SHARED.glob("*.candump.log.gz"))
    recording = decode_can_log(log, SHARED / "CSS-Electronics-SAE-J1939-DEMO.dbc", {"rpm": "EEC1.EngineSpeed"})
    rpm = recording.signal("rpm")
    assert len(rpm.values) == 12719
    assert np.median(np.diff(rpm.time_s)) == pytest.approx(0.010, abs=1e-5)
    assert rpm.values.mean() == pytest.approx(650.05, abs=0.005)
    assert (rpm.values.min(), rpm.values.max()) == (646.5, 653.75)
    assert recording.trial.started_at.year == 2021


@pytest.mark.skipif(not SHARED.exists(), reason="the real log is not on this machine")
def test_mf4_of_an_engine_that_is_off():
    """Truth from the data set's README: EngineSpeed is 0 throughout."""
    recording = decode_can_log(
        SHARED / "00000001.MF4", SHARED / "CSS-Electronics-SAE-J1939-DEMO.dbc", {"rpm": "EEC1.EngineSpeed"}
    )
    assert not recording.signal("rpm").values.any()
    assert len(recording.signal("rpm").values) > 1000
