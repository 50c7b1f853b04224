"""The `[effects]` table: what it may say, what comes back from it, and what it takes off the residuals."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.errors import ConfigError
from sawbench.modeling.effects.catalogue import EFFECTS
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.machines.known_effects import entry_of, known_effects
from sawbench.modeling.machines.linear_axis import AxisBaseline
from sawbench.modeling.machines.parameter_sets import parameter_set
from sawbench.modeling.machines.table import JIGSAW, axis_of
from sawbench.modeling.residuals import bare_residuals, residuals

from tests.rigs.drawn_states import BASELINE, running

pytestmark = pytest.mark.contract

SAW = parameter_set("paper_jigsaw").config
AXIS = parameter_set("linear_axis").config
AXIS_MODEL = AxisBaseline(config=AXIS.linear_axis, force_scale_n=40.0, stroke_m=0.1, top_speed_m_s=0.3)
EVERY = [(SAW, None, effect) for effect in JIGSAW.effects(BASELINE)] + [
    (AXIS, AXIS_MODEL, effect) for effect in axis_of(AXIS.linear_axis).effects(AXIS_MODEL)
]


def with_effects(config, **effects):
    return config.model_copy(update={"effects": effects})


def known_of(effect, form):
    """One and a half of its typical magnitude, with unequal phases."""
    carried = effect.carried_by(form)
    shape = next(s for s in effect.shapes if set(s) == {*form, carried} - {None} and form.items() <= s.items())
    value = effect.reported_strength(1.0 if carried else 1.5 * effect.strength.typical, shape)
    count = effect.n_signatures(shape)
    direction = (1.0,) if count == 1 else tuple(1.0 / (k + 1.0) for k in range(count))
    scales = {name: 0.7 * getattr(AXIS_MODEL, name, 30.0) for name in effect.scales}
    return KnownEffect(effect=effect, value=value, std=0.1 * abs(value), form=form, direction=direction, scales=scales)


@pytest.mark.parametrize(
    ("config", "model", "effect"), EVERY, ids=[f"{e.name}-{'saw' if m is None else 'axis'}" for _, m, e in EVERY]
)
def test_every_form_of_every_effect_comes_back_from_its_entry(config, model, effect):
    for shape in effect.shapes:
        form = {key: value for key, value in shape.items() if key not in effect.carries}
        known = known_of(effect, form)
        (back,) = known_effects(with_effects(config, **{effect.name: entry_of(known)}), path="x.toml", model=model)
        assert (back.value, back.std, back.direction, back.scales) == (
            known.value, known.std, known.direction, known.scales
        )  # fmt: skip
        assert back.shape == pytest.approx(known.shape, rel=1e-5)
        np.testing.assert_allclose(back.coefficients, known.coefficients)


@pytest.mark.parametrize("effect", JIGSAW.effects(BASELINE), ids=lambda effect: effect.name)
def test_a_known_effect_takes_its_signature_off_the_residuals(effect):
    for shape in effect.shapes[:2]:
        form = {key: value for key, value in shape.items() if key not in effect.carries}
        known = replace(known_of(effect, form), scales={})
        state = running()
        bare, less = bare_residuals(BASELINE, state), residuals(replace(BASELINE, known=(known,)), state)
        signatures = effect.signatures(BASELINE, state, known.shape)
        moved = 0.0
        for equation, wave in bare.items():
            expected = sum(
                c * s[equation] for c, s in zip(known.coefficients, signatures, strict=True) if equation in s
            )
            np.testing.assert_allclose(wave - less[equation], expected, atol=1e-6 * max(1.0, np.abs(wave).max()))
            moved = max(moved, float(np.max(np.abs(expected))))
        # At this gear ratio the slots snap out of step with the stroke: mean strokes do not show them.
        assert moved > 0.0 or effect.name == "cogging_torque"


@pytest.mark.parametrize("effect", JIGSAW.effects(BASELINE), ids=lambda effect: effect.name)
def test_uncertainty_is_what_one_standard_uncertainty_changes(effect):
    """Of small steps: half a percent either way moves the residuals by what the derivative says."""
    form = {key: value for key, value in effect.shapes[0].items() if key not in effect.carries}
    known = known_of(effect, form)
    small = KnownEffect(
        effect=effect, value=known.value, std=0.005 * abs(known.value), form=form, direction=known.direction
    )
    found = small.uncertainty(BASELINE, running())
    up, down = (small.at(known.value * (1.0 + sign * 0.005)).signature(BASELINE, running()) for sign in (1.0, -1.0))
    for equation, wave in found.items():
        np.testing.assert_allclose(wave, 0.5 * (up[equation] - down[equation]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"guide_friktion": {"force_n": 5.0}}, "did you mean 'guide_friction'?"),
        ({"guide_friction": {"force": 5.0}}, "unknown key 'force'"),
        ({"guide_friction": {"std": 0.5}}, "missing key 'force_n'"),
        ({"guide_friction": {"force_n": "5"}}, "must be a finite number, got '5'"),
        ({"guide_friction": {"force_n": True}}, "must be a finite number, got True"),
        ({"guide_friction": {"force_n": 5000.0}}, "check the unit, which is N"),
        ({"guide_friction": {"force_n": -5.0}}, "far outside the usual range"),
        ({"guide_friction": {"force_n": 5.0, "std": -0.1}}, "std must not be negative, got -0.1"),
        ({"edge_force": {"force_n": 5.0, "form": "straight"}}, "tables of numbers: { by_stock"),
        ({"engagement_delay": {"fraction": 0.05, "form": "straight"}}, "has no form 'straight'"),
        ({"cutting_speed_exponent": {"exponent": 5.5}}, "far outside the usual range, 0.1 to 1.6"),
        ({"guide_friction": {"force_n": 5.0, "form": {"static_ratio": 9.0, "stribeck_m_s": 0.1}}}, "static_ratio = 9"),
        ({"blade_wear": {"growth_per_10_m": 0.2, "form": "straight"}}, "named forms: linear"),
        ({"winding_heating": {"thermal_resistance_k_per_w": 4.0, "form": {"fast_s": 41.0}}}, "no form has the numbers"),
        ({"gear_eccentricity": {"torque_n_m": 0.003}}, "missing key 'direction': 2 numbers"),
        ({"gear_eccentricity": {"torque_n_m": 0.003, "direction": [1.0]}}, "must hold 2 numbers"),
        ({"cogging": {"amplitude_n": 2.0}}, "it needs linear drive"),
    ],
)
def test_a_wrong_entry_gets_one_error_with_file_and_place(entry, said):
    with pytest.raises(ConfigError) as error:
        known_effects(with_effects(SAW, **entry), path="bench_config.toml")
    assert said in str(error.value)
    assert f"bench_config.toml: [effects] {next(iter(entry))}" in str(error.value)


def test_the_table_of_the_contract_is_read():
    text = """
    guide_friction = { force_n = 5.1, std = 0.4 }
    blade_wear = { growth_per_10_m = 0.21, std = 0.03, form = "linear" }
    """
    friction, wear = known_effects(with_effects(SAW, **tomllib.loads(text)), path="x.toml")
    assert (friction.value, friction.std, friction.shape["static_ratio"]) == (5.1, 0.4, 1.0)
    assert (wear.value, wear.std, wear.shape) == (0.21, 0.03, {"power": 1.0})


def test_a_size_that_goes_with_the_load_may_be_that_of_a_light_saw():
    entry = {"battery_internal_resistance": {"extra_resistance_ohm": 4.0}}
    (known,) = known_effects(with_effects(SAW, **entry), path="x.toml")
    assert known.value == 4.0
    with pytest.raises(ConfigError, match="check the unit, which is Ohm"):
        known_effects(with_effects(SAW, battery_internal_resistance={"extra_resistance_ohm": 40.0}), path="x.toml")


def test_an_axis_takes_a_form_relative_to_the_travel_that_is_stated():
    entry = {"guide_friction": {"force_n": 8.0, "form": {"presliding": 0.02, "slope": 0.0}, "stroke_m": 0.05}}
    (known,) = known_effects(with_effects(AXIS, **entry), path="x.toml", model=AXIS_MODEL)
    assert known.scales == {"stroke_m": 0.05}


def test_names_of_forms_are_forms():
    for effect in EFFECTS:
        forms = [{k: v for k, v in shape.items() if k not in effect.carries} for shape in effect.shapes]
        for name, form in effect.form_names.items():
            assert dict(form) in forms, f"{effect.name}: {name}"


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_the_form_without_its_magnitude_still_says_which_form_it_is(effect):
    """As a saturating force was written as its exponent alone, and read back as a power law."""
    for shape in effect.shapes:
        form = {key: number for key, number in shape.items() if key not in effect.carries}
        found = KnownEffect(effect=effect, value=effect.reported_strength(1.0, shape), form=form).shape
        assert set(found) == set(shape)
        if form != shape:
            assert all(found[key] == pytest.approx(number, rel=1e-6) for key, number in shape.items())
