"""The examples in the docstrings of every module run and print what they say."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest
import sawbench

pytestmark = pytest.mark.unit


def _modules() -> list[str]:
    found = ["sawbench"]
    for part in sawbench.PACKAGES:
        package = importlib.import_module(f"sawbench.{part}")
        found += [package.__name__]
        found += [info.name for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]
    return found


@pytest.mark.parametrize("name", _modules())
def test_examples_hold(name):
    failed, tried = doctest.testmod(importlib.import_module(name))
    assert failed == 0, f"{failed} of {tried} examples of {name} fail: run `python -m doctest -v` on its file"
