"""TOML that is written reads back as it was."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from sawbench.bench.config import parse_config
from sawbench.bench.toml_writing import toml_text

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("path", ["bench_config.toml", "modeling/machines/linear_axis.toml"])
def test_configurations_read_back_as_they_were(path):
    tables = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    text = toml_text(tables, {(): ["head"], ("plant",): ["of the saw"], ("effects", "x"): ["nowhere"]})
    assert tomllib.loads(text) == tables
    assert text.startswith("# head\n")
    assert parse_config(text).config == parse_config(Path(path).read_text(encoding="utf-8")).config


def test_names_and_values_that_need_quotes():
    tables = {"a b": 1, "text": 'say "hi"\n\x7f', "table": {"x.y": [1.5, True, {"z": -1e-7}], "inline": {"k": 1e300}}}
    assert tomllib.loads(toml_text(tables)) == tables
