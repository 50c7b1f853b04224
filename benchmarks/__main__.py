"""All figures in one run: `python -m benchmarks [--quick] [--busy] [--only NAME ...] [--out PAGE | --update PAGE]`.

Measures sawbench against its peers and against what the hardware allows, section by section, each in a process of its
own: recorder, storage, period and fold, simulation and fit, one recording, an hour of one, many on several workers,
diagnosis, commands. Prints the page; with --out it is written, its pictures beside it; with --update these sections,
and their goals, take the place of those in a page that is there. A section that fails is named on the page, and the
exit code is 1.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import importlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.measuring import Clock, Goal, Section
from benchmarks.page import draw, goals_text, section_text, updated

ROOT = Path(__file__).parents[1]
SECTIONS = {
    "signals": "signals",
    "model": "model_speed",
    "recorder": "recorder_speed",
    "storage": "storage_speed",
    "recordings": "recordings_speed",
    "long": "long_recording",
    "batch": "batch_scaling",
    "diagnosis": "diagnosis_speed",
    "commands": "command_times",
}


def measure_apart(name: str, clock: Clock) -> Section:
    """Measure one section in a process of its own, on one BLAS thread."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "section.json"
        flags = [f"--{field}" for field, is_on in dataclasses.asdict(clock).items() if is_on]
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks", "--only", name, "--json", str(path), *flags],
            cwd=ROOT, check=False, stdout=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        if done.returncode == 0:
            return Section.of(json.loads(path.read_text(encoding="utf-8")))
    failed = Goal(what=f"section {name} measured", value=float(done.returncode), bound=0.0)
    return Section(title=name, words=[f"**Failed** with exit code {done.returncode}."], goals=[failed])


def said_of(command: str, clock: Clock) -> str:
    """Say what wrote a page or a section, when, where, and what its times are."""
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    counted = "processor time, because others used the machine" if clock.busy else "wall time"
    machine = f"{os.cpu_count()} {platform.machine()} cores, Python {platform.python_version()}"
    return f"Written by `{command}` on {today}: {machine}; {counted}; medians of calls in turns, quartiles in brackets."


def page(sections: list[Section], pictures: dict[str, str], command: str, clock: Clock) -> str:
    """The page, Markdown."""
    goals = [goal for section in sections for goal in section.goals]
    n_met = sum(goal.is_met is True for goal in goals)
    return "\n\n".join(
        [
            "# Speed against peers and limits",
            f"{said_of(command, clock)} Only ratios travel to other machines.",
            f"{n_met} of {len(goals)} goals are met.",
            goals_text(goals),
            *(section_text(section, pictures) for section in sections),
        ]
    )


def main() -> int:
    """Measure, print, and write the page where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="shorter trials, a fifth of the time, no slow commands")
    parser.add_argument("--busy", action="store_true", help="processor time: others use the machine")
    parser.add_argument("--only", choices=SECTIONS, nargs="+", default=list(SECTIONS), help="these sections")
    parser.add_argument("--out", type=Path, help="write the page there")
    parser.add_argument("--json", type=Path, help="of a single section: its numbers, measured in this process")
    parser.add_argument("--update", type=Path, metavar="PAGE", help="put these sections into a page that is there")
    options = parser.parse_args()
    clock = Clock(busy=options.busy, quick=options.quick)
    if options.json is not None:
        section = importlib.import_module(f"benchmarks.{SECTIONS[options.only[0]]}").measure(clock)
        options.json.write_text(json.dumps(dataclasses.asdict(section)), encoding="utf-8")
        return 0
    sections = []
    for name in options.only:
        print(f"measuring {name}", file=sys.stderr, flush=True)
        sections.append(measure_apart(name, clock))
    numbers = {name: value for section in sections for name, value in section.numbers.items()}
    if {"fit_s", "bytes_a_sample"} <= set(numbers):
        sections.append(importlib.import_module("benchmarks.recordings_speed").plan(numbers))
    pictures = {}
    target = options.out or options.update
    if target is not None:
        folder = target.parent / "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        for plot in (plot for section in sections for plot in section.plots):
            draw(plot, folder / f"benchmark-{plot.name}.svg")
            pictures[plot.name] = f"pictures/benchmark-{plot.name}.svg"
    command = " ".join(["python -m benchmarks", *sys.argv[1:]])
    if options.update is None:
        text = page(sections, pictures, command, clock) + "\n"
    else:
        text = updated(options.update.read_text(encoding="utf-8"), sections, pictures, said_of(command, clock))
    print(text)
    if target is not None:
        target.write_text(text, encoding="utf-8")
    return 0 if all("Failed" not in " ".join(section.words) for section in sections) else 1


if __name__ == "__main__":
    sys.exit(main())
