"""Every fitted number is held by a principle, which half of it and twice of it break."""

from __future__ import annotations

import pytest
from sawbench.diagnosis.inference.settings import SETTINGS, marks

from tests.rigs.principles import PRINCIPLES, table

pytestmark = pytest.mark.unit

EACH = [pytest.param(p, id=f"{p.number}: {p.says}") for p in PRINCIPLES]


@pytest.mark.parametrize("principle", EACH)
def test_a_number_keeps_its_principle(principle):
    assert principle.holds(SETTINGS)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("principle", EACH)
def test_half_and_twice_of_a_fitted_number_break_its_principle(principle, factor):
    assert not principle.holds(SETTINGS.moved(principle.number, factor))


def test_every_fitted_number_has_a_principle_and_every_number_a_source():
    fitted = {name for name, mark, _ in marks() if mark == "fitted"}
    assert fitted == {p.number for p in PRINCIPLES}
    assert all(source for _, _, source in marks())


def test_the_table_names_every_principle():
    lines = table().splitlines()
    assert len(lines) == 1 + len(PRINCIPLES)
    for principle, line in zip(PRINCIPLES, lines[1:], strict=True):
        assert line.startswith(principle.number)
        assert line.endswith(principle.says)


def test_moving_one_number_leaves_the_others():
    moved = SETTINGS.moved("forms.shares", 2.0)
    assert moved.forms.shares == tuple(2.0 * share for share in SETTINGS.forms.shares)
    assert moved.weights is SETTINGS.weights
    floor = SETTINGS.moved("sensors.floor", 2.0).sensors.floor
    assert floor["mechanical"] == tuple(2.0 * least for least in SETTINGS.sensors.floor["mechanical"])
    with pytest.raises(AttributeError):
        SETTINGS.moved("weights.no_such_number", 2.0)
