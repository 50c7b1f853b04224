"""Lines of numbers and what they are told to be."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.line_recognition import recognise_lines

pytestmark = pytest.mark.unit


def sent(lines, ending="\r\n"):
    """With a first line that was cut and a last one that is not whole."""
    return ("7.1" + ending + ending.join(lines) + ending + "12").encode()


def test_codes_of_an_hx711_with_and_without_a_label():
    codes = 84_210 + np.round(40 * np.sin(np.arange(80))).astype(int)
    for label in ("", "HX711 reading: "):
        found = recognise_lines(sent([f"{label}{code}" for code in codes]), 1.05)
        assert (found.driver, found.settings) == ("hx711", {"rate_hz": 80.0})


def test_numbers_that_only_grow_are_time_stamps():
    stamps = 4_000_000 + np.cumsum(np.full(14, 71_400))
    found = recognise_lines(sent([str(stamp) for stamp in stamps], "\n"), 1.0)
    assert found.driver == "edge_times"


def test_a_decimal_number_is_described_by_a_pattern():
    found = recognise_lines(sent([f"Reading: {0.5 + 0.01 * (k % 7):.2f} kg" for k in range(40)]), 1.0)
    assert found.driver == "text_lines"
    assert found.settings["rate_hz"] == 40.0 and "pattern" in found.settings


@pytest.mark.parametrize(("separator", "stated"), [(";", ";"), (",", ","), ("\t", "\t"), (" ", None)])
def test_columns_are_told_by_their_separator_and_a_counter_by_its_steps(separator, stated):
    lines = [separator.join([f"{0.1 * (k % 5):.3f}", str(k % 50), "-2e3"]) for k in range(100)]
    found = recognise_lines(sent(lines), 1.0)
    assert found.driver == "text_lines" and found.column == 1
    assert found.settings.get("separator") == stated
    assert found.settings["counter_column"] == 2


@pytest.mark.parametrize(
    "received", [b"", b"1\n2\n", bytes(range(256)) * 20, b"hello world\r\n" * 30, b"\xaa\x10\xb0" * 400]
)
def test_what_is_no_lines_of_numbers_is_nothing(received):
    assert recognise_lines(received, 1.0) is None
