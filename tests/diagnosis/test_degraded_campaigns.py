"""Degraded campaigns through the whole diagnosis: a more modest answer, never a confident wrong one.

Run by `pytest -m slow tests/diagnosis/test_degraded_campaigns.py`; half a minute a case. What must be refused is
tested before the diagnosis proper, in tests/diagnosis/test_screening.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.blindcheck.campaign import make_campaign
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.storage.importers.campaign import load_campaign
from sawbench.storage.importers.dispatch import import_path
from sawbench.storage.reader import read_recording

pytestmark = [pytest.mark.pipeline, pytest.mark.slow]
TRUTH = "motor_coulomb_friction"


@pytest.fixture(scope="module", params=["friction", "nothing"])
def campaign(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    effects = {TRUTH: 1.5} if request.param == "friction" else {}
    make_campaign(12 if effects else 11, folder / "tables", effects=effects, length=0.5)
    paths = import_path(folder / "tables" / "campaign.toml", folder / "mcap").paths
    recordings = [read_recording(path) for path in paths]
    return recordings, load_campaign(folder / "tables" / "campaign.toml")[1], set(effects)


def without(*names):
    return lambda rs: [replace(r, signals={n: s for n, s in r.signals.items() if n not in names}) for r in rs]


def settings(**changes):
    return lambda rs: [replace(r, trial=replace(r.trial, **changes)) for r in rs]


def one_point(recordings):
    cuts = [r for r in recordings if not r.trial.is_idle]
    first = cuts[0].trial
    return [r for r in cuts if (r.trial.duty, r.trial.thickness_mm) == (first.duty, first.thickness_mm)][:3]


def no_repeats(recordings):
    return list(
        {(r.trial.duty, r.trial.is_idle, r.trial.thickness_mm, r.trial.feed_mm_s): r for r in recordings}.values()
    )


def doubled_battery_current(recordings):
    out = []
    for r in recordings:
        signal = r.signals["battery_current_a"]
        doubled = replace(signal, values=2.0 * np.asarray(signal.values))
        out.append(replace(r, signals={**r.signals, "battery_current_a": doubled}))
    return out


CASES = {
    "one operating point": one_point,
    "one trial": lambda rs: one_point(rs)[:1],
    "one idle trial": lambda rs: [r for r in rs if r.trial.is_idle][:1],
    "idle runs only": lambda rs: [r for r in rs if r.trial.is_idle],
    "no idle run": lambda rs: [r for r in rs if not r.trial.is_idle],
    "no repeats": no_repeats,
    "no force": without("force_n"),
    "no displacement": without("displacement_mm"),
    "no motor current": without("motor_current_a"),
    "no battery voltage": without("battery_voltage_v"),
    "no battery current": without("battery_current_a"),
    "no current at all": without("motor_current_a", "battery_current_a"),
    "force and displacement only": without("motor_current_a", "battery_current_a", "battery_voltage_v"),
    "workpiece unsaid": settings(material=None),
    "thickness unsaid": settings(thickness_mm=None),
    "start unsaid": settings(started_at=None),
    "battery current doubled": doubled_battery_current,
}


@pytest.mark.parametrize("case", CASES)
def test_no_wrong_effect_is_claimed_with_confidence(campaign, case):
    recordings, config, truth = campaign
    report = diagnose(CASES[case](recordings), config, provenance={})
    for cause in report["causes"]:
        if not truth & set(cause["effects"]):
            assert cause["probability"] < 0.5, cause
    assert sum(report["probabilities"].values()) <= 1.0 + 1e-9
    if case != "no idle run":
        assert report["warnings"], "what weakens the answer is said"
