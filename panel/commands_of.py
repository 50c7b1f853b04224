"""What is entered in a form of the panel -> the arguments of a command of sawbench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

# Field of a form -> option, in the order of the form.
_RECORD: Final = {
    "material": "--material", "trial": "--trial", "seconds": "--seconds", "duty": "--duty",
    "thickness": "--thickness", "feed": "--feed", "blade": "--blade", "battery": "--battery",
    "operator": "--operator", "repetition": "--repetition", "note": "--note",
}  # fmt: skip
_TARE: Final = {"seconds": "--seconds", "operator": "--operator", "note": "--note"}
_CALIBRATE: Final = {"channel": "--channel", "seconds": "--seconds", "operator": "--operator", "note": "--note"}
_NUMBERS: Final = frozenset({"seconds", "duty", "thickness", "feed", "duties", "feeds", "thicknesses"})
# Option, where the label of its field has other words.
LABELS: Final = {"seconds": "Duration or averaging time", "trial": "Name of the trial"}
_PLAN_MANY: Final = {
    "materials": "--material", "duties": "--duty", "feeds": "--feed", "thicknesses": "--thickness",
}  # fmt: skip
_PLAN: Final = {"repetitions": "--repetitions", "seed": "--seed", "seconds": "--seconds", "operator": "--operator"}


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchOptions:
    """Which bench the panel works on.

    Attributes
    ----------
    recordings : Path
        Folder of the recordings.
    config_path : Path, optional
        As `--config`.
    simulated : bool
    """

    recordings: Path
    config_path: Path | None = None
    simulated: bool = False

    @property
    def config(self) -> list[str]:
        """The configuration as arguments."""
        return [] if self.config_path is None else ["--config", str(self.config_path)]

    @property
    def bench(self) -> list[str]:
        """Configuration and kind of bench as arguments."""
        return [*self.config, *(["--simulated"] if self.simulated else [])]


@dataclass(frozen=True, kw_only=True, slots=True)
class Call:
    """One command to start; `{folder}` in the arguments is the folder of its job."""

    kind: str
    title: str
    arguments: list[str]
    form: Mapping[str, str] = field(default_factory=dict)


def check(options: BenchOptions, form: Mapping[str, str]) -> Call:
    """`sawbench check`."""
    running = ["--running"] if form.get("running") else []
    return Call(kind="check", title="check of the instruments", arguments=["check", *options.bench, *running, "--json"])


def tare(options: BenchOptions, form: Mapping[str, str]) -> Call:
    """`sawbench tare`."""
    arguments = ["tare", *options.bench, *_given(form, _TARE), "--json"]
    return Call(kind="tare", title="tare of the load cell", arguments=arguments, form=form)


def calibrate(options: BenchOptions, form: Mapping[str, str]) -> Call:
    """`sawbench calibrate`, which asks for load after load."""
    flags = [option for name, option in (("kilograms", "--kilograms"), ("replace", "--force")) if form.get(name)]
    arguments = ["calibrate", *options.bench, *_given(form, _CALIBRATE), *flags, "--json"]
    return Call(kind="calibrate", title=f"calibration of {form.get('channel', '')}", arguments=arguments, form=form)


def record(options: BenchOptions, form: Mapping[str, str]) -> Call:
    """`sawbench record`; without a duration until stopped."""
    until = [] if form.get("seconds", "").strip() else ["--until-stopped"]
    out = ["--out", str(options.recordings)]
    arguments = ["record", *_given(form, _RECORD), *until, *out, *options.bench, "--json"]
    title = f"trial {form.get('trial') or form.get('material', '')}"
    return Call(kind="record", title=title, arguments=arguments, form=form)


def series_plan(options: BenchOptions, form: Mapping[str, str], out: Path) -> list[str]:
    """`sawbench series plan`."""
    many = [
        argument
        for name, option in _PLAN_MANY.items()
        for value in form.get(name, "").split(";" if ";" in form.get(name, "") else ",")
        if value.strip()
        for argument in (f"{option}={_entered(name, value)}",)
    ]
    block = ["--block", form["block"]] if form.get("block") else []
    idle = ["--idle"] if form.get("idle") else []
    folder = ["--recordings", str((options.recordings / out.stem).resolve())]
    return ["series", "plan", *many, *_given(form, _PLAN), *block, *idle, *folder, "--out", str(out), *options.config]


def series_run(options: BenchOptions, plan: Path, form: Mapping[str, str]) -> Call:
    """`sawbench series run`."""
    arguments = ["series", "run", str(plan), *_given(form, {"operator": "--operator"}), *options.bench, "--json"]
    return Call(kind="series", title=f"series {plan.stem}", arguments=arguments, form=form)


def report(options: BenchOptions, recording: Path) -> Call:
    """`sawbench report` of one recording."""
    arguments = ["report", str(recording), "--out", "{folder}", *options.config, "--json"]
    return Call(kind="report", title=f"page of {recording.stem}", arguments=arguments, form={"file": str(recording)})


def compare(options: BenchOptions, recordings: Sequence[Path]) -> Call:
    """`sawbench compare`."""
    files = [str(path) for path in recordings]
    arguments = ["compare", *files, "--out", "{folder}/comparison.html", *options.config, "--json"]
    return Call(kind="compare", title=f"comparison of {len(files)} recordings", arguments=arguments)


def diagnose(options: BenchOptions, recordings: Sequence[Path], form: Mapping[str, str]) -> Call:
    """`sawbench diagnose`."""
    files = [str(path) for path in recordings]
    plan = ["--plan", "3"] if form.get("plan") else []
    arguments = ["diagnose", *files, "--out", "{folder}/gap", *plan, *options.config, "--json"]
    return Call(kind="diagnose", title=f"diagnosis of {len(files)} recordings", arguments=arguments)


def _given(form: Mapping[str, str], options: Mapping[str, str]) -> list[str]:
    """Return options for the fields that are filled in; with `=`, so that no value is taken for an option."""
    return [f"{option}={value}" for name, option in options.items() if (value := _entered(name, form.get(name, "")))]


def _entered(name: str, text: str) -> str:
    """Return what was entered in a field; a number may have a decimal comma."""
    return text.strip().replace(",", ".") if name in _NUMBERS else text.strip()
