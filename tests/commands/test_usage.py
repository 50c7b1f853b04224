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


@pytest.mark.parametrize(
    ("command", "first"),
    [("record", "./bench_config.toml"), ("tare", "./bench_config.toml"), ("series run", "that of the plan"),
     ("fit", "that of the recording")],
)  # fmt: skip
def test_help_says_which_configuration_is_used_where_none_is_named(command, first, capsys):
    assert main([*command.split(), "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"Bench configuration; default: {first}" in shown and "else that of the package" in shown


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_unknown_option_is_wrong_usage(name, capsys):
    assert main([name, "--no-such-option"]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_unknown_command_is_wrong_usage(capsys):
    assert main(["saw"]) == 2
    assert "saw" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--duty", "--k-fc-std"])
def test_what_a_recording_states_itself_is_no_option_beside_it(option, capsys):
    assert main(["runtime", "recordings/oak-01.mcap", option, "0.5"]) == 2
    assert "go with --k-fc" in capsys.readouterr().err


def test_a_recording_has_a_duration_or_is_stopped(capsys):
    call = ["record", "--material", "oak", "--simulated", "--until-stopped", "--seconds", "5"]
    assert main(call) == 2
    assert "--until-stopped and --seconds exclude each other" in capsys.readouterr().err
