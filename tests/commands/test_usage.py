"""Every subcommand: help with an example, wrong usage answered in one message with exit code 2."""

from __future__ import annotations

import pytest
from sawbench.commands.main import SUBCOMMANDS, main

pytestmark = pytest.mark.contract


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_help_has_an_example(name, capsys):
    assert main([name, "--help"]) == 0
    shown = capsys.readouterr().out
    assert f"sawbench {name}" in shown
    assert "Example" in shown


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_unknown_option_is_wrong_usage(name, capsys):
    assert main([name, "--no-such-option"]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_unknown_command_is_wrong_usage(capsys):
    assert main(["saw"]) == 2
    assert "saw" in capsys.readouterr().err
