"""Batch extraction against cantools' own decoder, on random payloads."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.can_signals import counts_of, find_signal, frame_mask, load_dbc, needed_length, raw_signal
from sawbench.acquisition.devices.dbc_can_emulator import put_bits
from sawbench.bench.errors import ConfigError

pytestmark = pytest.mark.unit

DBC = """VERSION ""
BU_: A
BO_ 100 Mixed: 8 A
 SG_ IntelU12 : 3|12@1+ (1,0) [0|0] "" A
 SG_ IntelS17 : 15|17@1- (1,0) [0|0] "" A
 SG_ MotoU12 : 39|12@0+ (1,0) [0|0] "" A
 SG_ MotoS13 : 42|13@0- (1,0) [0|0] "" A
BO_ 101 Wide: 8 A
 SG_ MotoU64 : 7|64@0+ (1,0) [0|0] "" A
BO_ 102 Real: 8 A
 SG_ IntelFloat : 0|32@1- (1,0) [0|0] "" A
 SG_ MotoFloat : 39|32@0- (1,0) [0|0] "" A
BO_ 103 Other: 8 A
 SG_ IntelU12 : 0|12@1+ (1,0) [0|0] "" A
BO_ 2364540158 Eec1: 8 A
 SG_ Speed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" A
SIG_VALTYPE_ 102 IntelFloat : 1;
SIG_VALTYPE_ 102 MotoFloat : 1;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2364540158 3;
"""


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "mixed.dbc"
    path.write_text(DBC)
    return load_dbc(path)


@pytest.mark.parametrize("name", ["Mixed", "Wide", "Real"])
def test_same_numbers_as_cantools(database, name):
    rng = np.random.default_rng(11)
    payload = rng.integers(0, 256, (200, 8), dtype=np.uint8)
    message = database.get_message_by_name(name)
    ours = {s.name: raw_signal(s, payload) for s in message.signals}
    for k in range(len(payload)):
        theirs = message.decode(payload[k].tobytes(), scaling=False)
        for signal, value in theirs.items():
            assert ours[signal][k] == pytest.approx(float(value), rel=1e-15, nan_ok=True)


def test_what_the_emulator_writes_cantools_reads(database):
    message = database.get_message_by_name("Mixed")
    rng = np.random.default_rng(5)
    bits = np.zeros((50, 64), dtype=np.uint8)
    wanted = {}
    for signal in message.signals:
        half = 1 << (signal.length - 1)
        low, high = (-half, half) if signal.is_signed else (0, 2 * half)
        wanted[signal.name] = rng.integers(low, high, 50)
        put_bits(bits, signal, wanted[signal.name])
    payload = np.packbits(bits, axis=1)
    for k in range(50):
        decoded = message.decode(payload[k].tobytes(), scaling=False)
        assert {n: int(v) for n, v in decoded.items()} == {n: int(v[k]) for n, v in wanted.items()}


def test_needed_length_is_that_of_the_last_bit(database):
    message = database.get_message_by_name("Mixed")
    by_name = {s.name: s for s in message.signals}
    assert needed_length([by_name["IntelU12"]]) == 2
    assert needed_length([by_name["IntelS17"]]) == 4
    assert needed_length([by_name["MotoU12"]]) == 6


@pytest.mark.parametrize(
    ("kind", "stated", "expected"),
    [
        ("4@1+ (1,0)", "0|14", (0, 15)),
        ("4@1+ (1,0)", "1|15", (1, 15)),
        ("4@1+ (1,0)", "0|0", (0, 16)),
        ("4@1+ (1,0)", "0|65535", (0, 16)),
        ("8@1+ (2,10)", "10|408", (0, 200)),
        ("8@1- (1,0)", "0|0", (-128, 256)),
    ],
)
def test_counts_are_those_of_the_stated_range(tmp_path, kind, stated, expected):
    dbc = tmp_path / "counter.dbc"
    dbc.write_text(
        f'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 100 M: 8 A\n SG_ C : 0|{kind} [{stated}] "" A\n',
    )
    assert counts_of(load_dbc(dbc).get_message_by_name("M").get_signal_by_name("C")) == expected


def test_a_signal_name_in_two_messages_needs_its_message(database):
    with pytest.raises(ConfigError, match=r"in 2 messages"):
        find_signal(database, "IntelU12", where="test")
    assert find_signal(database, "Other.IntelU12", where="test")[0].name == "Other"


def test_an_unknown_signal_gets_a_suggestion(database):
    with pytest.raises(ConfigError, match=r"IntelU12"):
        find_signal(database, "Mixed.IntelU13", where="test")


@pytest.mark.parametrize(
    ("identifier", "is_ours"),
    [(0x0CF004FE, True), (0x18F00400, True), (0x0CF00500, False), (0x0CEF0400, False)],
)
def test_j1939_matches_by_group(database, identifier, is_ours):
    mask, wanted = frame_mask(database.get_message_by_name("Eec1"))
    assert (((identifier | 1 << 31) & mask) == wanted) is is_ours


def test_a_missing_or_broken_dbc_is_said(tmp_path):
    with pytest.raises(ConfigError, match="no such DBC"):
        load_dbc(tmp_path / "none.dbc")
    broken = tmp_path / "broken.dbc"
    broken.write_text("BO_ what")
    with pytest.raises(ConfigError, match="not a readable DBC"):
        load_dbc(broken)
