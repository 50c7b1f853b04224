"""`--json`: the documented schema, errors too."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
from sawbench.commands.main import SUBCOMMANDS, main

from tests.commands.conftest import SCHEMA, check_json

pytestmark = pytest.mark.contract

OAK = str(Path(__file__).parents[2] / "recordings" / "oak-01.mcap")
NOTHING_PRINTED = {"simbench", "panel", "watch"}


def printed(capsys, *arguments):
    code = main([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_schema_is_one_and_names_the_commands():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    named = {command.split()[0] for command in SCHEMA["properties"]}
    assert named <= set(SUBCOMMANDS)
    assert set(SUBCOMMANDS) - named <= NOTHING_PRINTED
    for definition in SCHEMA["properties"].values():
        assert definition["$ref"].removeprefix("#/$defs/") in SCHEMA["$defs"]


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("info", (OAK,)),
        ("info", (OAK, OAK)),
        ("machines", ()),
        ("export", (OAK, "--format", "csv", "--out", "{folder}/tables")),
        ("recover", (OAK, "--out", "{folder}/whole.mcap")),
        ("series plan", ("--material", "oak", "--feed", "2", "--seed", "1", "--out", "{folder}/plan.toml")),
        ("init", ("--simulated", "{folder}/bench")),
    ],
)
def test_what_a_command_prints_is_as_documented(capsys, tmp_path, command, arguments):
    code, found = printed(capsys, *command.split(), *(one.format(folder=tmp_path) for one in arguments))
    assert code == 0
    check_json(command, found)


def test_what_the_catalogue_prints_is_as_documented(capsys, tmp_path):
    assert main(["process", OAK, "--archive", str(tmp_path / "archive")]) == 0
    capsys.readouterr()
    code, found = printed(capsys, "catalogue", tmp_path / "archive")
    assert (code, [entry["trial_id"] for entry in found]) == (0, ["oak-01"])
    check_json("catalogue", found)


@pytest.mark.parametrize(
    ("arguments", "where", "words"),
    [
        (("fit", "nowhere.mcap"), "nowhere.mcap", ""),
        (("info", OAK, "--no-such-option"), None, "--no-such-option"),
        (("recover", OAK, "--out", OAK), OAK, ""),
    ],
)
def test_an_error_is_json_with_the_exit_code(capsys, arguments, where, words):
    code, found = printed(capsys, *arguments)
    check_json("error", found)
    assert code == found["error"]["exit_code"] == 2
    assert found["error"]["where"] == where
    assert words in found["error"]["what"]


def test_what_could_be_used_is_printed_with_the_exit_code_of_what_could_not(capsys, tmp_path):
    """As the page says of several recordings, and of a path that does not exist."""
    page = (Path(__file__).parents[2] / "docs" / "json_output.md").read_text(encoding="utf-8")
    (tmp_path / "bad.mcap").write_bytes(b"")
    code, found = printed(capsys, "fit", OAK, tmp_path / "bad.mcap")
    assert [one["trial"] for one in found] == ["oak-01"]
    assert f"{code} for a wrong file" in page
    code, found = printed(capsys, "fit", OAK, tmp_path / "nowhere.mcap")
    assert found["error"]["where"] == str(tmp_path / "nowhere.mcap")
    assert f"however many paths there are; the exit code is {code}" in page


def test_the_schema_refuses_what_it_should():
    with pytest.raises(jsonschema.ValidationError):
        check_json("fit", [{"trial": "oak-01"}])
    with pytest.raises(jsonschema.ValidationError):
        check_json("error", {"error": "text"})
