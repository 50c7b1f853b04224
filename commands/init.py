"""`sawbench init`: a bench configuration, by asking and by looking at what is plugged in."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.commands.options import json_option, refuse_unwritable_folder
from sawbench.commands.terminal import emit, table
from sawbench.inputs import DEFAULT_CONFIG, shipped_config

if TYPE_CHECKING:
    from sawbench.acquisition.bench_search import FoundInstrument, FoundPort

# Device of the configuration that ships -> what it is to the person who is asked.
_ROLES: Final[Mapping[str, str]] = {
    "load_cell": "load cell: force",
    "stroke_sensor": "stroke sensor: displacement",
    "power": "motor current and battery",
}
_NONE: Final = "none"
_AGAIN: Final = "again"
# Key of the configuration -> question; asked where the parameter set of the machine has the key.
_NUMBERS: Final[Mapping[str, str]] = {
    "nominal_voltage_v": "Nominal battery voltage, V",
    "capacity_ah": "Battery capacity, Ah",
    "default_duty": "PWM duty of the motor, 0..1",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """One device of the new configuration.

    Attributes
    ----------
    device : str
        Name of its table.
    table : mapping
        Its table.
    is_found : bool
        Whether an instrument answered there.
    """

    device: str
    table: Mapping[str, Any]
    is_found: bool


@click.command(name="init", epilog="Example: sawbench init workshop")
@click.argument("folder", default=".", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--machine", help="Parameter set of the tool, see `sawbench machines`; default: paper_jigsaw, or asked for."
)
@click.option("--simulated", is_flag=True, help="For the simulated bench: no questions, no search for instruments.")
@click.option("--defaults", is_flag=True, help="No questions: use the instruments found and the defaults.")
@json_option
def command(folder: Path, machine: str | None, simulated: bool, defaults: bool, as_json: bool) -> int:
    """Write FOLDER/bench_config.toml: the tool, the instruments, their ports and serial numbers.

    Asks, with an answer proposed for every question. Each serial port is sent the requests of the known instruments, to
    see which one answers. A file that exists is never changed. Exit code 1 where an instrument was not found.
    """
    from sawbench.bench.config import load_config
    from sawbench.bench.errors import InputError

    path = folder / DEFAULT_CONFIG
    if path.exists():
        raise InputError("already exists", where=path, remedy="give another folder: `sawbench init FOLDER`")
    refuse_unwritable_folder(folder)
    is_asking = not (simulated or defaults)
    tool = tool_text(machine, ask=_ask if is_asking else _default)
    shipped = load_config(shipped_config()).config
    if simulated:
        _refuse_other_than_a_saw(tool)
        places = [Place(device=name, table=t, is_found=False) for name, t in shipped.devices.items()]
    else:
        places = find_places(shipped.devices, ask=_ask if is_asking else _default)
    text = config_text(tool, shipped.recording.model_dump(exclude_none=True), places, simulated=simulated)
    _require_valid(text, path)
    folder.mkdir(parents=True, exist_ok=True)
    with path.open("x", encoding="utf-8") as file:
        file.write(text)
    devices = [{"device": p.device, **p.table, "is_found": p.is_found} for p in places]
    emit({"path": path, "simulated": simulated, "devices": devices}, _summary(path, places, simulated), as_json=as_json)
    return 0 if simulated or all(p.is_found for p in places) else 1


def _ask(question: str, default: str) -> str:
    from sawbench.bench.errors import InputError

    try:
        return str(click.prompt(question, default=default, err=True)).strip()
    except click.Abort:
        if sys.stdin.isatty():
            raise
        raise InputError(
            "the input ended before the last question was answered",
            remedy="run it in a terminal, or without questions: --defaults, --simulated",
        ) from None


def _default(_question: str, default: str) -> str:
    return default


def tool_text(machine: str | None, *, ask: Callable[[str, str], str]) -> str:
    """Return the tables of the tool: a parameter set of the package, with the numbers that were answered.

    Parameters
    ----------
    machine : str, optional
        Its name; asked for where none is given.
    ask : callable
        (question, default) -> answer.

    Raises
    ------
    InputError
        If there is no such parameter set.
    """
    from sawbench.modeling.machines.parameter_sets import names, parameter_set

    text = parameter_set(machine or ask(f"Machine: {', '.join(names())}", "paper_jigsaw")).text
    for key, question in _NUMBERS.items():
        stated = re.search(rf"^{key} = ([^\s#]+).*$", text, flags=re.MULTILINE)
        if stated is None:
            continue
        answer = _number(question, stated[1], ask)
        if float(answer) != float(stated[1]):
            # The source beside the former number is not that of the new one.
            text = text.replace(stated[0], f"{key} = {float(answer)!r}  # as answered to `sawbench init`")
    return text


def _number(question: str, default: str, ask: Callable[[str, str], str]) -> str:
    while True:
        answer = ask(question, default)
        try:
            is_positive = 0 < float(answer) < float("inf")
        except ValueError:
            is_positive = False
        if is_positive:
            return answer
        click.echo(f"{answer!r} is not a number above 0", err=True)


class Search:
    """What is plugged in, as far as it was looked for.

    Attributes
    ----------
    ports : tuple of FoundPort
    found : tuple of FoundInstrument
    """

    def __init__(self) -> None:
        self.ports: tuple[FoundPort, ...] = ()
        self.found: tuple[FoundInstrument, ...] = ()

    def list_ports(self) -> None:
        """Find the ports; nothing is sent to them."""
        from sawbench.acquisition.bench_search import find_ports

        self.ports = find_ports()
        click.echo("ports: " + (", ".join(p.port for p in self.ports) or "none on this machine"), err=True)

    def identify(self) -> None:
        """Find out what answers at the ports, and show it."""
        self.found = self._identified(self.ports)

    def at(self, port: str) -> FoundInstrument | None:
        """Return what answers at a port; one that was not listed is asked now."""
        from sawbench.acquisition.bench_search import SERIAL, FoundPort

        if all(p.port != port for p in self.ports):
            place = FoundPort(interface=SERIAL, port=port)
            self.ports, self.found = (*self.ports, place), (*self.found, *self._identified((place,)))
        return next((f for f in self.found if f.place.port == port), None)

    @staticmethod
    def _identified(ports: Sequence[FoundPort]) -> tuple[FoundInstrument, ...]:
        from sawbench.acquisition.bench_search import identify

        found = identify(ports, watch=lambda driver: click.echo(f"looking for {driver} ...", err=True))
        shown = {f.place: [f.place.port, f.driver, f.serial_number or "-", f.about] for f in found}
        rows = [shown.get(p, [p.port, "-", "-", p.about]) for p in ports]
        click.echo(table(["port", "driver", "serial number", "what answers"], rows), err=True)
        return found


def find_places(shipped: Mapping[str, Mapping[str, Any]], *, ask: Callable[[str, str], str]) -> list[Place]:
    """Look at the ports, propose an instrument for every device of the configuration that ships, and ask.

    Parameters
    ----------
    shipped : mapping
        Device -> its table.
    ask : callable
        (question, default) -> answer.

    Returns
    -------
    list of Place
        Without the devices that were answered by "none".
    """
    search = Search()
    search.list_ports()
    question = "Detect the instruments? Requests are sent to each port; other equipment may not expect them (y/n)"
    if search.ports and ask(question, "y").lower().startswith("y"):
        search.identify()
    places: list[Place] = []
    for device, table_shipped in shipped.items():
        place = _place(device, table_shipped, search, {p.table["port"] for p in places}, ask)
        places += [] if place is None else [place]
    return places


def _place(
    device: str, shipped: Mapping[str, Any], search: Search, used: set[str], ask: Callable[[str, str], str]
) -> Place | None:
    role = _ROLES.get(device, device)
    while True:
        fitting = [f.place.port for f in search.found if f.place.port not in used and _fits(f, shipped)]
        default = fitting[0] if fitting else str(shipped["port"])
        port = ask(f"Port of the {role} ({_AGAIN}: search again; {_NONE}: none)", default)
        if port == _AGAIN:
            search.list_ports()
            search.identify()
        elif port == _NONE:
            return None
        elif port in used:
            click.echo(f"{port} is already used by another device", err=True)
        else:
            break
    # A port of the configuration that ships is an example: nobody said that something is there.
    known = search.at(port) if fitting or port != default else None
    if known is not None and not _fits(known, shipped):
        click.echo(f"{known.driver} at {port} provides no {role}: configured as {shipped['driver']}", err=True)
        known = None
    return Place(device=device, table=_device_table(shipped, known, port), is_found=known is not None)


def _channels(table_: Mapping[str, Any]) -> set[str]:
    return {*table_.get("channels", {}), *table_.get("signals", {})}


def _fits(found: FoundInstrument, shipped: Mapping[str, Any]) -> bool:
    """Whether the instrument can be the device: the same driver, or one whose example gives such a channel."""
    return found.driver == shipped["driver"] or bool(_channels(found.proposed()) & _channels(shipped))


def _device_table(shipped: Mapping[str, Any], known: FoundInstrument | None, port: str) -> dict[str, Any]:
    from sawbench.acquisition.bench_search import SERIAL

    if known is None:
        return {**shipped, "port": port}
    is_shipped = known.driver == shipped["driver"]
    rest = shipped if is_shipped else known.proposed()
    interface = {} if known.place.interface == SERIAL else {"interface": known.place.interface}
    number = {} if known.serial_number is None else {"serial_number": known.serial_number}
    return {
        "driver": known.driver,
        "port": port,
        **number,
        **{k: v for k, v in rest.items() if k != "port"},
        **interface,
    }


def config_text(tool: str, recording: Mapping[str, Any], places: Sequence[Place], *, simulated: bool) -> str:
    """Put the configuration together.

    Parameters
    ----------
    tool : str
        TOML tables of the tool.
    recording : mapping
        Table `[recording]`.
    places : sequence of Place
    simulated : bool
        The instruments are emulated: ports are given by the simulated bench itself.
    """
    from sawbench.bench.toml_writing import toml_text

    comments: dict[tuple[str, ...], list[str]] = {("recording",): ["Folder and storage of the recordings."]}
    for place in places:
        said = comments.setdefault(("devices", place.device), [f"{_ROLES.get(place.device, place.device)}."])
        if simulated:
            said.append("Emulated: the port is not used with --simulated.")
        elif not place.is_found:
            said.append("This instrument was not found: correct the port.")
        else:
            said.append("With serial_number, another instrument at this port is refused.")
        if "channels" in place.table:
            said.append("Nominal calibration: replace it with that of the certificate, or use `sawbench calibrate`.")
    tables = {"recording": recording, "devices": {p.device: p.table for p in places}}
    return tool.rstrip() + "\n\n" + toml_text(tables, comments)


def _refuse_other_than_a_saw(tool: str) -> None:
    from sawbench.bench.config import parse_config

    parse_config(tool, where="--simulated").plant()


def _require_valid(text: str, path: Path) -> None:
    from sawbench.acquisition.devices import build_devices
    from sawbench.bench.config import parse_config

    config = parse_config(text, where=str(path)).config
    if config.devices:
        build_devices(config)


def _state(place: Place) -> str:
    return "found" if place.is_found else "not found"


def _summary(path: Path, places: Sequence[Place], simulated: bool) -> str:
    options = "" if path == DEFAULT_CONFIG else f" --config {shlex.quote(str(path))}"
    if simulated:
        return f"wrote {path}\nnext: sawbench record{options} --material oak --seconds 10 --simulated"
    rows = [
        [
            p.device,
            p.table["driver"],
            p.table["port"],
            p.table.get("serial_number", "-"),
            "" if p.is_found else "not found",
        ]
        for p in places
    ]
    lines = [f"wrote {path}", *([table(["device", "driver", "port", "serial number", "state"], rows)] if rows else [])]
    if any(not p.is_found for p in places):
        lines.append(f"correct the ports of the instruments not found in {path}")
    return "\n".join([*lines, f"next: sawbench check{options}"])
