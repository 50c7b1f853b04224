"""Pages of the documentation site that are made from the program: commands, configuration, Python, tutorial.

A hook of MkDocs (`hooks` in mkdocs.yml); the functions that make the text need no MkDocs.
"""

from __future__ import annotations

import inspect
import json
import posixpath
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from pydantic import BaseModel

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

FOLDER = Path(__file__).parent
_WIDTH = 100
# What people import, in the order of use.
_PYTHON = (
    ("sawbench.functions", "Functions", ["read", "process", "fit", "runtime", "simulate", "compare", "diagnose"]),
    ("sawbench.results", "Results", None),
    ("sawbench.bench.recording", "Recordings", None),
    ("sawbench.bench.processed", "Processed trials", None),
    ("sawbench.bench.folded", "Folded cycles", None),
    ("sawbench.modeling.results", "Fits and runtimes", None),
    ("sawbench.bench.errors", "Errors", None),
    ("sawbench.acquisition.devices.device", "Instruments", None),
    ("sawbench.acquisition.devices.instrument", "An instrument as a plug-in", None),
    ("sawbench.modeling.effects.effect", "Effects", None),
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the made pages."""
    from mkdocs.structure.files import File

    made = {
        "tutorial.md": tutorial_page,
        "reference/commands.md": commands_page,
        "reference/configuration.md": configuration_page,
        "reference/python.md": python_page,
    }
    for path, page in made.items():
        files.append(File.generated(config, path, content=page()))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Make links of the pages that a page names in backticks from the root of the repository."""
    # Pages of the program itself are no part of the site: one has the name of a page made from Markdown.
    named = re.sub(r"\[[^\]]+\]\(([\w./-]+\.html)\)", r"`docs/\1`", markdown)
    return linked(named, page.file.src_uri)


def linked(markdown: str, place: str) -> str:
    """Turn `docs/x.md` in backticks into a link from the page at `place`, where there is such a page.

    Examples
    --------
    >>> linked("see `docs/series.md`", "decisions/0001.md")
    'see [series.md](../series.md)'
    """

    def link(match: re.Match[str]) -> str:
        path = match[1]
        if not (FOLDER / path).exists():
            return match[0]
        return f"[{path}]({posixpath.relpath(path, posixpath.dirname(place) or '.')})"

    return re.sub(r"`docs/([\w./-]+\.md)`", link, markdown)


def tutorial_page() -> str:
    """Return the notebook as a page; it is stored without outputs, and the tests run it."""
    notebook = json.loads((FOLDER / "tutorial.ipynb").read_text(encoding="utf-8"))
    parts = []
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join([*parts, "Run it yourself: `docs/tutorial.ipynb`, from the folder `docs` of a clone."]) + "\n"


def commands_page() -> str:
    """Return the help of every command."""
    from sawbench.commands.main import SUBCOMMANDS, cli

    lines = ["# Commands", "", "What `--help` says.", ""]
    root = click.Context(cli, info_name="sawbench", terminal_width=_WIDTH, max_content_width=_WIDTH)
    for name in SUBCOMMANDS:
        command = cli.get_command(root, name)
        assert command is not None
        for context in _contexts(command, root, name):
            depth = "#" * min(4, context.command_path.count(" ") + 1)
            lines += [f"{depth} {context.command_path}", "", "```text", context.get_help().rstrip(), "```", ""]
    return "\n".join(lines)


def _contexts(command: click.Command, parent: click.Context, name: str) -> Iterator[click.Context]:
    context = click.Context(command, info_name=name, parent=parent, terminal_width=_WIDTH, max_content_width=_WIDTH)
    yield context
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            found = command.get_command(context, inner)
            if found is not None:
                yield from _contexts(found, context, inner)


def configuration_page() -> str:
    """Return every table and key of `bench_config.toml`, from the models that check it."""
    from sawbench.acquisition.calibration import Calibration
    from sawbench.acquisition.devices import INSTRUMENTS, load_instrument
    from sawbench.acquisition.devices.device import ChannelTable
    from sawbench.bench.config import BenchConfig

    lines = [
        "# Configuration", "",
        "The tables of `bench_config.toml`, as the program checks them. Every table may be missing; a command says "
        "which one it needs. Where a value is uncertain, write `{ nominal = 0.176, rel_std = 0.05 }` (one relative "
        "standard uncertainty) or the bare number. Units are in the names; relative paths start where the command "
        "runs.", "",
    ]  # fmt: skip
    schema = BenchConfig.model_json_schema()
    inner = schema["$defs"]
    for name, entry in schema["properties"].items():
        reference = _reference(entry)
        if reference is None:
            continue
        title = f"[{name}.NAME]" if "additionalProperties" in entry else f"[{name}]"
        lines += _table_of_keys(title, inner[reference], inner)
    for name in ("BatteryRange", "OpenCircuitTable"):
        lines += _table_of_keys(f"table {name}", inner[name], inner)
    lines += ["## [effects]", "", "Effects that the model holds: `docs/known_effects.md`.", ""]
    for driver in INSTRUMENTS:
        settings = load_instrument(driver).settings
        about = (inspect.getdoc(inspect.getmodule(settings)) or "").partition("\n")[0]
        lines += _documented(f'[devices.NAME] with driver = "{driver}"', settings, about=about)
    lines += _documented("[devices.NAME.channels.CHANNEL]", ChannelTable)
    lines += _documented("[devices.NAME.channels.CHANNEL.calibration]", Calibration)
    return "\n".join(lines)


def _table_of_keys(title: str, model: Mapping[str, Any], inner: Mapping[str, Any]) -> list[str]:
    about = inspect.cleandoc(model.get("description", ""))
    required = model.get("required", ())
    rows = [
        f"| `{key}` | {_kind(entry, inner)} | {_limits(entry)} | {'required' if key in required else _default(entry)} |"
        for key, entry in model["properties"].items()
    ]
    return [f"## {title}", "", about, "", "| key | value | allowed | default |", "|---|---|---|---|", *rows, ""]


def _reference(entry: Mapping[str, Any]) -> str | None:
    """Name of the model that an entry is, holds, or may be."""
    for one in (entry, *entry.get("anyOf", ()), *entry.get("allOf", ()), entry.get("additionalProperties")):
        if isinstance(one, Mapping) and "$ref" in one:
            return str(one["$ref"]).rpartition("/")[2]
    return None


def _kind(entry: Mapping[str, Any], inner: Mapping[str, Any]) -> str:
    name = _reference(entry)
    if name == "Uncertain":
        return "number, uncertain"
    if name is not None:
        return f"table {name}" if inner[name].get("type") == "object" else name
    if "enum" in entry:
        return " or ".join(f"`{value}`" for value in entry["enum"])
    kinds = [str(one.get("type")) for one in entry.get("anyOf", [entry]) if one.get("type") != "null"]
    return " or ".join(kinds).replace("object", "table").replace("array", "list")


def _limits(entry: Mapping[str, Any]) -> str:
    said = {"exclusiveMinimum": "above", "minimum": "from", "exclusiveMaximum": "below", "maximum": "to"}
    one = {**entry, **next((o for o in entry.get("anyOf", ()) if o.get("type") != "null"), {})}
    return " ".join(f"{word} {one[key]:g}" for key, word in said.items() if key in one)


def _default(entry: Mapping[str, Any]) -> str:
    value = entry.get("default")
    return "" if value is None else f"`{json.dumps(value)}`"


def _documented(title: str, model: type[BaseModel], *, about: str = "") -> list[str]:
    """Return the keys of a model whose docstring explains each of them; `about` stands in for its first words."""
    summary = inspect.cleandoc(model.__doc__ or "").partition("Attributes\n----------\n")[0]
    lines = [
        f"## {title}",
        "",
        about or summary.strip(),
        "",
        "| key | value | default | meaning |",
        "|---|---|---|---|",
    ]
    if "driver" in model.model_fields:
        lines.append("| `driver` | str | required | Which instrument it is. |")
    for key, (kind, said) in _explained(model).items():
        field = model.model_fields.get(key)
        default = "" if field is None else "required" if field.is_required() else _written(field.get_default())
        lines.append(f"| `{key}` | {kind.replace(', optional', '')} | {default} | {said} |".replace("|  |", "| |"))
    return [*lines, ""]


def _explained(model: type[BaseModel]) -> dict[str, tuple[str, str]]:
    """Key -> (kind, meaning), those of the models that it extends before its own."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(model.__mro__[: model.__mro__.index(BaseModel)]):
        rest = inspect.cleandoc(base.__doc__ or "").partition("Attributes\n----------\n")[2]
        rows = re.findall(r"^(\w[\w, ]*) : (.+)\n((?:[ ]{4}.+\n?)*)", re.split(r"\n\n", rest)[0], flags=re.MULTILINE)
        found |= {key: (kind, " ".join(said.split())) for names, kind, said in rows for key in names.split(", ")}
    return found


def _written(value: Any) -> str:
    return "" if value in (None, {}) or isinstance(value, BaseModel) else f"`{value}`"


def python_page() -> str:
    """Return the page that mkdocstrings fills from the docstrings."""
    lines = ["# Python", "", "`import sawbench` offers the functions; the rest is what they return and take.", ""]
    for module, title, members in _PYTHON:
        lines += [f"## {title}", "", f"::: {module}", "    options:", "      show_root_heading: false"]
        lines += [] if members is None else [f"      members: [{', '.join(members)}]"]
        lines.append("")
    return "\n".join(lines)
