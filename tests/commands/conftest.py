"""Whatever a test of this folder makes a command print as JSON is compared with the documented schema."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import click
import jsonschema
import pytest
from sawbench.commands import terminal

SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "json_output.schema.json").read_text(encoding="utf-8"))


def check_json(command: str, document) -> None:
    """`command` as it is typed, for example "series status"; "error" for an error."""
    place = "#/$defs/error" if command == "error" else SCHEMA["properties"].get(command, {}).get("$ref")
    if place is not None:
        jsonschema.validate(document, {"$schema": SCHEMA["$schema"], "$ref": place, "$defs": SCHEMA["$defs"]})


@pytest.fixture(autouse=True)
def json_is_as_documented(monkeypatch):
    def dumps(document, **options):
        context = click.get_current_context(silent=True)
        if context is not None:
            check_json(context.command_path.removeprefix("sawbench "), document)
        return json.dumps(document, **options)

    monkeypatch.setattr(terminal, "json", SimpleNamespace(dumps=dumps))
