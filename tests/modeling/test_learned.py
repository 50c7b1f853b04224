"""A learned term: its table between the nodes, its entry in a configuration, and what a prediction makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.errors import ConfigError
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import SITES, LearnedTerm, learned_effect, out_of_range
from sawbench.modeling.machines.known_effects import entry_of, known_effects
from sawbench.modeling.machines.linear_axis import AxisBaseline
from sawbench.modeling.machines.parameter_sets import parameter_set
from sawbench.modeling.operating_point import OperatingPoint, periodic_stroke
from sawbench.modeling.residuals import residuals

from tests.rigs.drawn_states import BASELINE, running

pytestmark = pytest.mark.contract

SPEEDS = tuple(np.linspace(40.0, 160.0, 5).tolist())
ANGLES = tuple((np.arange(16) * 2.0 * np.pi / 16).tolist())
TORQUE_N_M = 0.004


def known(term, value=1.0, std=0.1):
    return KnownEffect(effect=learned_effect(term), value=value, std=std)


def over_speed(values, **changes):
    values = np.asarray(values, dtype=float)
    given = {"site": "mechanical", "quantities": ("crank_speed_rad_s",), "nodes": (SPEEDS,), "stds": 0.1 + 0.0 * values}
    return LearnedTerm(**{**given, "values": values, **changes})


def read(entry, name="paper_jigsaw"):
    config = parameter_set(name).config.model_copy(update={"effects": {"learned": entry}})
    model = AxisBaseline(config=config.linear_axis, force_scale_n=40.0, stroke_m=0.1, top_speed_m_s=0.3)
    return known_effects(config, path="x.toml", model=model if config.linear_axis else None)


def test_between_the_nodes_it_is_a_spline_and_beyond_them_the_edge():
    angle, speed = np.array([0.1, 3.0, 6.2]), np.array([50.0, 111.0, 400.0])
    table = np.cos(np.array(ANGLES))[:, None] + 0.01 * np.array(SPEEDS)
    term = over_speed(table, quantities=("crank_angle_rad", "crank_speed_rad_s"), nodes=(ANGLES, SPEEDS))
    expected = np.cos(angle) + 0.01 * np.array([50.0, 111.0, 160.0])
    np.testing.assert_allclose(term.at([angle, speed]), expected, atol=2e-3)
    np.testing.assert_allclose(term.at([angle + 2.0 * np.pi, speed]), term.at([angle, speed]))


def test_known_to_the_model_it_is_taken_off_its_equation_alone():
    state = running()
    model = replace(BASELINE, known=(known(over_speed(np.full(5, TORQUE_N_M)), value=0.5),))
    before, after = residuals(BASELINE, state), residuals(model, state)
    for equation, wave in before.items():
        taken = 0.5 * TORQUE_N_M if equation == "mechanical" else 0.0
        np.testing.assert_allclose(wave - after[equation], taken, atol=1e-12)


def test_a_reading_of_the_load_cell_is_missed_by_the_balance_of_torques_too():
    state = running()
    (found,) = known(over_speed(np.full(5, 2.0), site="force_reading")).effect.signatures(BASELINE, state)
    np.testing.assert_allclose(found["cutting"], 2.0)
    np.testing.assert_allclose(found["mechanical"], -BASELINE.load_torque(state, np.full_like(state.angle_rad, 2.0)))


def test_in_air_it_is_silent_where_it_was_learned_from_cuts_alone():
    term = over_speed(np.full(5, 1.0), is_cutting_only=True)
    assert known(term).signature(BASELINE, running(is_idle=True)) == {}
    assert "mechanical" in known(term).signature(BASELINE, running())


def test_a_constant_torque_makes_the_stroke_of_coulomb_friction():
    point = OperatingPoint(k_fc_n_s_per_m=150.0, duty=0.45)
    effect = EFFECT_BY_NAME["motor_coulomb_friction"]
    friction = KnownEffect(effect=effect, value=TORQUE_N_M, form={"static_ratio": 1.0})
    named, learned, bare = (
        periodic_stroke(replace(BASELINE, known=one), point).state.current_a
        for one in ((friction,), (known(over_speed(np.full(5, TORQUE_N_M))),), ())
    )
    np.testing.assert_allclose(learned, named, rtol=1e-3)
    assert learned.mean() > 1.05 * bare.mean()


@pytest.mark.parametrize("site", SITES)
def test_an_entry_comes_back_as_it_was_written(site):
    term = over_speed(np.linspace(-1.0, 2.0, 5), site=site, is_cutting_only=site == "cutting")
    (back,) = read(entry_of(known(term, value=0.9, std=0.05)))
    read_back = back.effect.signature
    assert isinstance(read_back, LearnedTerm)
    assert (back.value, back.std, read_back.site, read_back.quantities) == (0.9, 0.05, site, term.quantities)
    assert read_back.is_cutting_only == term.is_cutting_only
    np.testing.assert_allclose(read_back.values, term.values)
    np.testing.assert_allclose(read_back.stds, term.stds)
    assert isinstance(back.effect, Effect) and back.effect.place == SITES[site][0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"equation": "hydraulic"}, "equation must be one of"),
        ({"quantities": ["phase_of_the_moon"]}, "quantities must be one to 3"),
        ({"quantities": ["time_s", "time_s"]}, "quantities must be one to 3"),
        ({"nodes": [[1.0, 2.0, 3.0]]}, "4 or more increasing numbers"),
        ({"nodes": [[1.0, 3.0, 2.0, 4.0, 5.0]]}, "4 or more increasing numbers"),
        ({"nodes": []}, "a list for each of"),
        ({"quantities": ["crank_angle_rad"]}, "divide one turn evenly"),
        ({"values": [1.0, 2.0]}, "need the shape"),
        ({"values": [1.0, 2.0, "x", 4.0, 5.0]}, "finite numbers"),
        ({"stds": [0.1, 0.1, -0.1, 0.1, 0.1]}, "not negative"),
        ({"cutting_only": 1}, "cutting_only must be true or false"),
        ({"std": -1.0}, "std not negative"),
        ({"torque_n_m": 1.0}, "unknown key 'torque_n_m'"),
    ],
)
def test_a_wrong_entry_is_one_error_with_file_and_place(changes, said):
    with pytest.raises(ConfigError, match=said) as raised:
        read(entry_of(known(over_speed(np.zeros(5)))) | changes)
    assert "x.toml: [effects] learned" in str(raised.value)


def test_a_missing_key_and_a_machine_without_such_quantities_are_refused():
    entry = entry_of(known(over_speed(np.zeros(5))))
    with pytest.raises(ConfigError, match="missing key 'values'"):
        read({key: value for key, value in entry.items() if key != "values"})
    with pytest.raises(ConfigError, match="does not support a learned term"):
        read(entry, name="linear_axis")


def test_use_beyond_the_range_is_said_once_a_quantity():
    state = running()  # some 80 to 97 rad/s
    within = known(over_speed(np.zeros(5)))
    beyond = known(over_speed(np.zeros(5), nodes=(tuple(np.linspace(10.0, 50.0, 5).tolist()),)))
    assert out_of_range((within,), BASELINE, [state, state]) == ()
    (said,) = out_of_range((beyond,), BASELINE, [state, state])
    assert "crank speed from 10 to 50 rad/s" in said
