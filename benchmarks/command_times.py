"""First and second call of every command: `python -m benchmarks.command_times [--quick] [--only tare blind]`.

The first call is that of a fresh installation: nothing compiled by numba, no cache of fonts, no settings. Every
command gets such folders of its own, in a process of its own; the second call finds what the first has left.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.archive import upload
from benchmarks.measuring import Clock, Goal, Section, Table
from tests.rigs.cells import shepherd_discharge

ROOT = Path(__file__).parents[1]
OAK = ROOT / "recordings" / "oak-01.mcap"
# Command -> arguments. {out}: folder with the configuration, the plan and a copy of a recording; {tables}: one with a
# CSV of a trial; {torn}: half a recording; {many} a folder with MANY different recordings; {plan} the plan of a series
# of one trial; {cells} discharges of a battery; {archive} results of the recordings; {sealed} a set of the blind check
# with a short campaign, {answered} the same with its answer, {key} its key.
MANY = 60
COMMANDS = {
    "--help": "--help",
    "init": "init --simulated {out}/bench",
    "machines": "machines",
    "simulate": "simulate",
    "info": f"info {OAK}",
    "process": f"process {OAK}",
    "fit": f"fit {OAK}",
    "runtime": f"runtime {OAK}",
    "report": f"report {OAK} --out {{out}}",
    "compare": f"compare {ROOT}/recordings --out {{out}}/page.html",
    f"compare, {MANY} recordings": "compare {many} --out {out}/page.html",
    "diagnose": f"diagnose {ROOT}/recordings --out {{out}}",
    "view": f"view {OAK} --no-view --rrd {{out}}/view.rrd",
    "export": f"export {OAK} --format parquet --out {{out}}",
    "recover": "recover {torn} --out {out}/whole.mcap",
    "import": "import {tables}/oak-01.force_n.csv --out {out}",
    "series plan": "series plan --material oak --feed 2 --out {out}/new.toml",
    "series status": "series status {plan}",
    "amend": "amend {out}/oak.mcap --duty 0.44 --by Kim --because mistyped",
    "catalogue": "catalogue {archive}",
    "watch --once": "watch {out} --archive {out}/archive --once",
    "battery fit": "battery fit {cells}/rate-1A.csv {cells}/rate-3A.csv {cells}/rate-6A.csv --out {out}/battery.toml",
    "blind make": "blind make --seed 21 --cases 1 --length 0.25 --jobs 1 --out {out}/set",
    "blind answer": "blind answer {sealed} --jobs 1 --answers {out}/answers",
    "blind score": "blind score {answered} --key {key} --out {out}/score.html",
    "check": "check --simulated --seconds 1",
    "tare": "tare --simulated --config {out}/bench_config.toml --seconds 2 --operator Kim",
    "calibrate": "calibrate --simulated --config {out}/bench_config.toml --point 0 --point 100 --point 200 --point 0"
    " --seconds 1",
    "series run": "series run {out}/plan.toml --simulated --yes",
    "simbench": "simbench --material oak",
    "panel": "panel --simulated --no-browser --port 0",
    "record": "record --material oak --simulated --seconds 2 --out {out}",
    "demo": "demo --no-view --out {out}/demo",
}
# These wait for instruments, or need more than a recording.
WAITING = ("check", "tare", "calibrate", "series run", "record", "demo")
# These run until they are stopped: timed until their first line of output.
STARTED = ("simbench", "panel")
SLOW = ("demo", "diagnose", "compare", f"compare, {MANY} recordings", "blind make", "blind answer", "blind score")
ONCE = ("demo",)  # the second call of this takes nearly as long: most of it is the recording
GOALS_S = {
    "fit": (5.0, 1.0),
    "runtime": (8.0, None),
    "demo": (40.0, None),
    f"compare, {MANY} recordings": (30.0, 30.0),
    "--help": (None, 0.3),
}


def run_command(arguments: list[str], caches: Path) -> tuple[float, float, int]:
    """Wall time and processor time of one call in a process of its own, s, and its exit code.

    A command of `STARTED` is stopped at its first line of output.
    """
    places = {"NUMBA_CACHE_DIR": "numba", "MPLCONFIGDIR": "matplotlib", "XDG_CACHE_HOME": "cache"}
    environment = {**os.environ, **{name: str(caches / folder) for name, folder in places.items()}}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "sawbench.commands.main", *arguments],
        env=environment, cwd=caches, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    code = 0
    with process:
        if arguments[0] in STARTED:
            assert process.stdout is not None
            code = 0 if process.stdout.readline() else 2
            wall_s = time.perf_counter() - start
            process.terminate()
        else:
            process.communicate()
            code, wall_s = process.returncode, time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, code


def prepare(folder: Path) -> dict[str, str]:
    """Write what some commands read."""
    run_command(["export", str(OAK), "--out", str(folder / "tables")], folder)
    torn = folder / "torn.mcap.part"
    torn.write_bytes(OAK.read_bytes()[: OAK.stat().st_size // 2])
    many, cells, sealed = folder / "many", folder / "cells", folder / "sealed"
    upload(MANY, str(many), every_corrupt=None)
    cells.mkdir()
    for current_a in (1, 3, 6):
        (cells / f"rate-{current_a}A.csv").write_text(discharge_table(float(current_a)), encoding="utf-8")
    plan = folder / "plan.toml"
    for text in (
        f"series plan --material oak --feed 2 --repetitions 1 --seconds 2 --operator Kim --out {plan}",
        f"process {ROOT}/recordings --archive {folder}/archive",
        f"blind make --seed 21 --cases 1 --length 0.25 --jobs 1 --out {sealed}",
    ):
        run_command(text.split(), folder)
    shutil.copytree(sealed, folder / "answered")
    run_command(["blind", "answer", str(folder / "answered"), "--jobs", "1"], folder)
    return {
        "tables": str(folder / "tables"), "torn": str(torn), "many": str(many), "cells": str(cells), "plan": str(plan),
        "archive": str(folder / "archive"), "sealed": str(sealed), "answered": str(folder / "answered"),
        "key": str(folder / "sealed.key.json"),
    }  # fmt: skip


def discharge_table(current_a: float) -> str:
    """One discharge of a cell at a steady current, as a tester exports it."""
    rows = zip(*shepherd_discharge(current_a), strict=True)
    lines = [f"{time_s:.2f},{-current:.3f},{volts:.4f}" for time_s, current, volts in rows]
    return "\n".join(["Test_Time(s),Current(A),Voltage(V)", *lines]) + "\n"


def measure(clock: Clock, only: Sequence[str] = ()) -> Section:
    """Time every command, or those of which `only` holds the first word, twice.

    In wall time, or in processor time on a busy machine.
    """
    rows, goals, which = [], [], 1 if clock.busy else 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        read = prepare(folder)
        for command, text in COMMANDS.items():
            if (clock.quick and command in SLOW) or (only and command.split()[0] not in only):
                continue
            caches, calls = folder / "caches", []
            caches.mkdir()
            for number in range(1 if command in ONCE else 2):
                out = folder / f"out-{len(rows)}-{number}"
                out.mkdir()
                shutil.copy(ROOT / "bench_config.toml", out)
                shutil.copy(OAK, out / "oak.mcap")
                shutil.copy(read["plan"], out)
                calls.append(run_command(text.format(out=out, **read).split(), caches))
            shutil.rmtree(caches)
            code = calls[0][2]
            walls, cpus = ([f"{call[k]:.2f} s" for call in calls] + [""] * (2 - len(calls)) for k in range(2))
            rows.append((f"`{command}`" + ("" if code in (0, 1) else f" (failed: {code})"), *walls, *cpus))
            for what, call, bound in zip(("first", "second"), calls, GOALS_S.get(command, (None, None)), strict=False):
                if bound is not None:
                    goals.append(Goal(what=f"{what} call of `{command}`", value=call[which], bound=bound, unit="s"))
    return Section(
        title="Commands",
        words=[
            "Each in a process of its own. The first call is that of a fresh installation: nothing is compiled yet, "
            f"there is no cache of fonts. {', '.join(f'`{name}`' for name in WAITING)} wait for the simulated "
            f"instruments most of the time. {', '.join(f'`{name}`' for name in STARTED)} run until they are stopped: "
            "time to their first line. The blind check: one campaign with a quarter of the usual duration."
        ],
        tables=[Table(head=("command", "first call", "second call", "processor, first", "second"), rows=rows)],
        goals=goals,
    )


def main() -> None:
    """Print the table."""
    from benchmarks.page import section_text

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"leave out {'; '.join(SLOW)}")
    parser.add_argument("--only", nargs="+", default=(), metavar="COMMAND", help="time these commands")
    parser.add_argument("--busy", action="store_true", help="judge processor time: others use the machine")
    options = parser.parse_args()
    print(section_text(measure(Clock(busy=options.busy, quick=options.quick), options.only)))


if __name__ == "__main__":
    main()
