"""Faults of the simulated instruments do to the bytes what their names say."""

import pytest
from sawbench.acquisition.simulation.faults import Fault, FaultySender

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("kind", "n_bytes", "expected"),
    [
        ("drop_bytes", 2, b"abcdefij"),
        ("garble_bytes", 1, b"abcdef" + bytes([ord("g") ^ 0xFF]) + b"hij"),
        ("flip_bits", 1, b"abcdeffhij"),
        ("double_bytes", 3, b"abcdefghfghij"),
    ],
)
def test_bytes_on_the_way(kind, n_bytes, expected):
    sender = FaultySender((Fault(device="d", kind=kind, at_s=1.0, n_bytes=n_bytes),))
    parts = ((0.5, b"abcd"), (1.0, b"efgh"), (1.1, b"ij"))
    assert b"".join(sender.through(part, since_s) for since_s, part in parts) == expected
