"""`sawbench machines`: the parameter sets that come with the package, each a complete configuration."""

from __future__ import annotations

import click
from sawbench.commands.options import json_option
from sawbench.commands.terminal import emit


@click.command(name="machines", epilog="Example: sawbench machines paper_jigsaw > bench_config.toml")
@click.argument("name", required=False)
@json_option
def command(name: str | None, as_json: bool) -> None:
    """List the machines that come with the package, or print the configuration of one."""
    from sawbench.modeling.machines.parameter_sets import names, parameter_set
    from sawbench.modeling.machines.table import machine_of

    if name is not None:
        chosen = parameter_set(name)
        emit(chosen.config.model_dump(mode="json", exclude_none=True), chosen.text.rstrip(), as_json=as_json)
        return
    sets = [parameter_set(each) for each in names()]
    rows = [{"name": s.name, "machine": machine_of(s.config).title, "about": s.about} for s in sets]
    lines = [f"{row['name']}: {row['machine']}\n  {row['about']}" for row in rows]
    emit(rows, "\n".join(lines), as_json=as_json)
