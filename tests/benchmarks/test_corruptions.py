"""Altered recordings: every alteration once, and many drawn ones; what is wrong must be said."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.storage.reader import read_recording

from benchmarks.corruptions import Alterations, chunks, judge, run, write_base

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("written")
    base, other = folder / "base.mcap", folder / "other.mcap"
    write_base(base, seed=1)
    write_base(other, seed=2)
    return read_recording(base), base.read_bytes(), Alterations(other.read_bytes())


def test_the_recording_is_whole_before(written):
    before, content, _ = written
    assert before.is_complete
    assert len(before.signal("force_n").values) == 4000
    assert len(chunks(content)) >= 4


@pytest.mark.parametrize("kind", Alterations(b"").names())
def test_every_alteration_is_said(written, tmp_path, kind):
    before, content, alterations = written
    altered = getattr(alterations, kind)(bytearray(content), np.random.default_rng(4))
    assert bytes(altered) != content
    path = tmp_path / "altered.mcap"
    path.write_bytes(altered)
    assert judge(before, path)[1] == ""


def test_a_recording_that_is_another_one_is_noticed(written, tmp_path):
    path = tmp_path / "other.mcap"
    write_base(path, seed=2)
    assert judge(written[0], path)[1].startswith("unsaid: 8000 foreign samples")


@pytest.mark.slow
def test_many_drawn_alterations():
    assert not [verdict for verdict in run(600) if verdict.wrong]
