"""Crosstalk between channels leaves what the nuisances say, and no more than an intact bench does."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sawbench.diagnosis.inference.crosstalk import crosstalk_nuisances
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.state import angle_derivative

from tests.rigs.jigsaw_in_time import BASELINE, RADIUS, Machine, compare, gap
from tests.rigs.read_stroke import read_ahead
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

INTACT = Machine().run()
SHARE = 0.02
# What a channel usually reaches.
USUAL = {
    "force_n": BASELINE.load.force_n, "motor_current_a": BASELINE.usual_current_a,
    "battery_current_a": BASELINE.usual_current_a, "battery_voltage_v": float(INTACT.battery_voltage_v.mean()),
    "displacement_mm": 2e3 * RADIUS,
}  # fmt: skip
ATTRIBUTE = {"motor_current_a": "current_a"}
READ = ("force_n", "motor_current_a", "displacement_mm")
PAIRS = [(source, channel) for source, channel in product(READ, USUAL) if source != channel]


def of(state, channel):
    """A channel of the state, in the unit of its name."""
    if channel == "displacement_mm":
        return 1e3 * RADIUS * (1.0 - np.cos(state.angle_rad))
    return getattr(state, ATTRIBUTE.get(channel, channel))


def misread(state, source, channel, share):
    """The state where a channel reads a share of another, both over what they usually reach."""
    too_much = share * USUAL[channel] / USUAL[source] * of(state, source)
    if channel == "displacement_mm":
        return read_ahead(state, 1e-3 * too_much.mean(axis=0))
    read = {ATTRIBUTE.get(channel, channel): of(state, channel) + too_much}
    if channel == "motor_current_a":
        read["current_rate_a_s"] = state.current_rate_a_s + state.speed_rad_s * angle_derivative(too_much)
    if channel == "battery_voltage_v":
        read["motor_voltage_v"] = state.motor_voltage_v + state.setting.duty * too_much
    return replace(state, **read)


def said(source, channel):
    found = [one for one in crosstalk_nuisances() if one.name.startswith(f"{source} in {channel}")]
    assert sum(one.std**2 for one in found) == pytest.approx(SETTINGS.sensors.crosstalk**2)
    return [one.signature(BASELINE, INTACT) for one in found]


@pytest.mark.parametrize(("source", "channel"), [pair for pair in PAIRS if pair[1] != "displacement_mm"])
def test_a_channel_that_reads_another_leaves_what_its_nuisance_says(source, channel):
    before, after = gap(INTACT), gap(misread(INTACT, source, channel, SHARE))
    [claimed] = said(source, channel)
    claimed = {name: SHARE * wave for name, wave in claimed.items()}
    compare({name: after[name] - before[name] for name in after}, claimed, 0.01)


def test_a_displacement_that_reads_the_motor_s_current_leaves_what_its_nuisances_say():
    """But for a tenth, whatever the noise lets the tracker follow by itself."""
    before, after = gap(INTACT), gap(misread(INTACT, "motor_current_a", "displacement_mm", 2e-3))
    for equation in ("electrical", "mechanical", "cutting"):
        change = (after[equation] - before[equation])[0]
        waves = np.column_stack([wave[equation][0] for wave in said("motor_current_a", "displacement_mm")])
        left = change - waves @ np.linalg.lstsq(waves, change)[0]
        assert left @ left < 0.1 * (change @ change)


def test_what_a_channel_does_not_have_it_reads_nowhere():
    without = replace(INTACT, force_n=None)
    of_force = [one for one in crosstalk_nuisances() if one.name.startswith("force_n in")]
    assert of_force
    assert all(one.signature(BASELINE, without) == {} for one in of_force)


def test_a_converter_that_has_not_settled_leaves_no_more_than_one_that_has():
    left = []
    for share in (0.0, -2e-3):
        problem = problem_of([misread(state, "displacement_mm", "battery_current_a", share) for state in strokes()])
        [intact] = [h for h in judge(problem, effect_columns(problem)).hypotheses if h.name == "no_gap"]
        left.append(intact.left_over)
    assert left[1] < 1.2 * left[0]
