"""First and second call of every command: `python -m benchmarks.command_times [--quick]`.

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
from pathlib import Path

from benchmarks.archive import upload
from benchmarks.measuring import Clock, Goal, Section, Table

ROOT = Path(__file__).parents[1]
OAK = ROOT / "recordings" / "oak-01.mcap"
# Command -> arguments; {out} is an empty folder, {tables} one with a CSV of a trial, {torn} half a recording, {many} a
# folder with MANY different recordings.
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
    "series plan": "series plan --material oak --feed 2 --out {out}/plan.toml",
    "check": "check --simulated --seconds 1",
    "record": "record --material oak --simulated --seconds 2 --out {out}",
    "demo": "demo --no-view --out {out}/demo",
}
# These wait for instruments, or need more than a recording.
WAITING = ("check", "record", "demo")
LEFT_OUT = "tare, calibrate, series run, simbench (they wait for instruments), battery fit, blind"
SLOW = ("demo", "diagnose", "compare", f"compare, {MANY} recordings")
ONCE = ("demo",)  # the second call of this takes nearly as long: most of it is the recording
GOALS_S = {
    "fit": (5.0, 1.0),
    "runtime": (8.0, None),
    "demo": (40.0, None),
    f"compare, {MANY} recordings": (30.0, 30.0),
    "--help": (None, 0.3),
}


def run_command(arguments: list[str], caches: Path) -> tuple[float, float, int]:
    """Wall time and processor time of one call in a process of its own, s, and its exit code."""
    places = {"NUMBA_CACHE_DIR": "numba", "MPLCONFIGDIR": "matplotlib", "XDG_CACHE_HOME": "cache"}
    environment = {**os.environ, **{name: str(caches / folder) for name, folder in places.items()}}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "sawbench.commands.main", *arguments],
        env=environment, cwd=caches, capture_output=True, check=False,
    )  # fmt: skip
    wall_s, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.returncode


def prepare(folder: Path) -> dict[str, str]:
    """Write what some commands read."""
    run_command(["export", str(OAK), "--out", str(folder / "tables")], folder)
    torn = folder / "torn.mcap.part"
    torn.write_bytes(OAK.read_bytes()[: OAK.stat().st_size // 2])
    many = folder / "many"
    upload(MANY, str(many), every_corrupt=None)
    return {"tables": str(folder / "tables"), "torn": str(torn), "many": str(many)}


def measure(clock: Clock) -> Section:
    """Time every command twice, in wall time, or in processor time on a busy machine."""
    rows, goals, which = [], [], 1 if clock.busy else 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        read = prepare(folder)
        for command, text in COMMANDS.items():
            if clock.quick and command in SLOW:
                continue
            caches, calls = folder / "caches", []
            caches.mkdir()
            for number in range(1 if command in ONCE else 2):
                out = folder / f"out-{len(rows)}-{number}"
                out.mkdir()
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
            f"instruments most of the time. Not timed: {LEFT_OUT}."
        ],
        tables=[Table(head=("command", "first call", "second call", "processor, first", "second"), rows=rows)],
        goals=goals,
    )


def main() -> None:
    """Print the table."""
    from benchmarks.page import section_text

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"leave out {'; '.join(SLOW)}")
    parser.add_argument("--busy", action="store_true", help="judge processor time: others use the machine")
    options = parser.parse_args()
    print(section_text(measure(Clock(busy=options.busy, quick=options.quick))))


if __name__ == "__main__":
    main()
