"""`sawbench machines`: every parameter set is a configuration that the commands take."""

import json
import re
from pathlib import Path

import pytest
import sawbench.modeling.machines
from sawbench.bench.config import parse_config
from sawbench.commands.main import main
from sawbench.modeling.machines.parameter_sets import names, parameter_set

pytestmark = pytest.mark.contract


def test_the_list_names_every_file(capsys):
    assert main(["machines"]) == 0
    shown = capsys.readouterr().out
    files = {path.stem for path in Path(sawbench.modeling.machines.__file__).parent.glob("*.toml")}
    assert files and all(name in shown for name in files)
    assert main(["machines", "--json"]) == 0
    assert {row["name"] for row in json.loads(capsys.readouterr().out)} == files


@pytest.mark.parametrize("name", names())
def test_what_is_printed_is_a_complete_configuration(name, capsys, tmp_path):
    assert main(["machines", name]) == 0
    text = capsys.readouterr().out
    chosen = parameter_set(name)
    assert parse_config(text).config == chosen.config
    if chosen.config.plant is not None:
        (tmp_path / "c.toml").write_text(text, encoding="utf-8")
        assert main(["simulate", "--config", str(tmp_path / "c.toml"), "--seconds", "0.5", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["stroke_rate_hz"] > 5


@pytest.mark.parametrize("name", names())
def test_every_number_has_its_source(name):
    numbers = [line for line in parameter_set(name).text.splitlines() if re.search(r"=\s*(\{.*)?-?\d", line)]
    assert numbers and all(re.search(r"#\s*\w{2}", line) for line in numbers)


def test_an_unknown_machine_is_refused_with_the_names(capsys):
    assert main(["machines", "chainsaw"]) == 2
    assert "paper_jigsaw" in capsys.readouterr().err
