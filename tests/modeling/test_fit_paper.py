"""docs/paper.md is what the program computes, and what it computes is what the paper prints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.errors import InputError

from benchmarks import paper_table
from benchmarks.appendix_a import appendix_a_rows
from benchmarks.paper_reproduction import reproduce, skewed_half_sine

pytestmark = pytest.mark.unit

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def found():
    return reproduce()


def row(found, quantity):
    matches = [row for row in found.rows if row.quantity.startswith(quantity)]
    assert len(matches) >= 1, quantity
    return matches[0]


def test_page_is_what_the_program_writes(found):
    assert (ROOT / "docs" / "paper.md").read_text(encoding="utf-8") == paper_table.page(found)


@pytest.mark.parametrize(
    ("quantity", "low", "high"),
    [
        ("start-up peak of the motor current", 34.72, 34.74),
        ("k_Fc, least squares", 0.95 * 240.0, 1.05 * 240.0),
        ("k_Fc, simulated annealing", 0.95 * 240.0, 1.05 * 240.0),
        ("RMSE of the motor current", 0.43, 0.50),
        ("runtime, linear force", 0.98 * 927.0, 1.02 * 927.0),
        ("runtime, real force / linear force", 1.039 - 0.012, 1.039 + 0.012),
        ("Appendix A, runtime, measured", 845.5, 846.5),
        ("Appendix A, runtime, linear", 926.4, 927.0),
        ("Appendix A, runtime, nonlinear", 873.3, 874.3),
        ("Appendix A, linear longer", 9.45, 9.65),
        ("Appendix A, nonlinear longer", 3.2, 3.4),
        ("stroke rate at 240.29", 13.8, 14.0),
        ("stroke rate, blade in air", 17.8, 18.0),
    ],
)
def test_published_figures(found, quantity, low, high):
    assert low <= row(found, quantity).value <= high


def test_readings_that_do_not_give_the_figures_are_shown_as_such(found):
    assert row(found, "the same, cutting on 0..pi").is_reproduced is False
    assert row(found, "runtime, linear force, with Appendix A's 2.5 Ah").is_reproduced is False
    assert row(found, "runtime, real force").is_reproduced is True  # the ratio
    assert next(r for r in found.rows if r.quantity == "runtime, real force").is_reproduced is None


def test_annealing_and_least_squares_agree(found):
    values = [r.value for r in found.rows if r.quantity.startswith("k_Fc")]
    assert np.ptp(values) < 0.05


def test_appendix_a_is_charge_over_current():
    values = {r.quantity: r.value for r in appendix_a_rows()}
    assert values["Appendix A, runtime, linear"] * 7.77 == pytest.approx(7200.0)


def test_skewed_half_sine_has_its_peak_where_it_says_and_is_zero_elsewhere():
    force = skewed_half_sine(100.0, 0.6, 1000)
    assert force.argmax() == 800
    assert force.max() == pytest.approx(100.0)
    assert not force[:501].any()
    with pytest.raises(InputError, match="place"):
        skewed_half_sine(100.0, 1.0)
