"""Time of a diagnosis over trials, and of the whole command; its accuracy against the peers stands in docs/peers.md."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sawbench.bench.config import load_config
from sawbench.blindcheck.campaign import make_campaign
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.storage.importers import import_path
from sawbench.storage.reader import read_recording
from threadpoolctl import threadpool_limits

from benchmarks.measuring import Clock, Goal, Plot, Section, Table

PEERS_PAGE = Path(__file__).parents[1] / "docs" / "peers.md"
SEED = 811  # one of the seeds for tuning
# Factor on the length of the trials that makes 18 of them 1.1 million rows, the campaign that the goal names.
LENGTH = 1.45
# Rows of docs/peers.md that say most.
ROWS = (
    "exact effect, typical single effects",
    "false alarms: an effect is claimed, none or parameters only",
    "called unknown, effects outside the catalogue",
    "log-loss / nats",
    "time per case, median / s",
)


def accuracy() -> Table:
    """The rows of docs/peers.md, as its own command measured them."""
    lines = PEERS_PAGE.read_text(encoding="utf-8").splitlines()
    head = next(line for line in lines if line.startswith("| row |"))
    cells = {line.split("|")[1].strip(): line for line in lines if line.startswith("| ")}
    short = [
        tuple(re.sub(r" \(.*?\)(, [\d/]+)?", "", cell).strip() for cell in cells[name].split("|")[1:-1])
        for name in ROWS
        if name in cells
    ]
    names = tuple(cell.strip() for cell in head.split("|")[1:-1])
    return Table(title="Accuracy against the peers, from docs/peers.md", head=names, rows=short)


def campaign(folder: Path, length: float):
    """Write a campaign of 18 trials with guide friction; return its recordings and its configuration."""
    make_campaign(SEED, folder, effects={"guide_friction": 1.0}, length=length)
    paths = import_path(folder / "campaign.toml", folder / "imported").paths
    return [read_recording(path) for path in paths], load_config(folder / "bench_config.toml")


def whole_command(folder: Path) -> float:
    """Wall time of `sawbench diagnose`, from the start of the process to the page, s: the shorter of two calls."""
    arguments = [str(folder / "imported"), "--config", str(folder / "bench_config.toml"), "--out", str(folder / "gap")]
    took_s = []
    for _ in range(2):
        start = time.perf_counter()
        call = [sys.executable, "-m", "sawbench.commands.main", "diagnose", *arguments, "--force"]
        subprocess.run(call, check=True, capture_output=True)
        took_s.append(time.perf_counter() - start)
    return min(took_s)


def rows_of(recordings) -> int:
    """Rows of the tables of some trials: samples of one channel."""
    return sum(max(len(signal.values) for signal in recording.signals.values()) for recording in recordings)


def measure(clock: Clock) -> Section:
    """Time of `diagnose` without page over the number of trials, on one thread, and of the whole command."""
    with tempfile.TemporaryDirectory() as place:
        recordings, loaded = campaign(Path(place) / "campaign", 0.25 if clock.quick else LENGTH)
        command_s = whole_command(Path(place) / "campaign")
    rows, numbers, seconds = [], (6, 12, 18), []
    with threadpool_limits(limits=1, user_api="blas"):
        diagnose(recordings[: numbers[0]], loaded, provenance={})  # compiles
        for n in numbers:
            report = {}
            seconds.append(
                clock.once(lambda n=n, report=report: report.update(diagnose(recordings[:n], loaded, provenance={})))
            )
            n_rows = f"{rows_of(recordings[:n]) / 1e6:.2f} million"
            rows.append((str(n), n_rows, f"{seconds[-1]:.1f} s", report["verdict"]))
    whole = f"{rows_of(recordings) / 1e6:.1f} million rows"
    return Section(
        title="Diagnosis",
        words=[
            "A campaign of the blind check with guide friction, diagnosed on one thread, page not counted. All effects "
            "of the catalogue are weighed every time, so the number of trials decides the cost.",
            f"The whole command, which reads {len(recordings)} trials of {whole} and draws the page, takes "
            f"{command_s:.1f} s of wall time: a second core gets half of the trials, effects and pictures.",
        ],
        tables=[Table(head=("trials", "rows", "time", "verdict"), rows=rows), accuracy()],
        goals=[
            Goal(what="diagnosis of 18 trials", value=seconds[-1], bound=15.0, unit="s"),
            Goal(what=f"`diagnose` of {whole}", value=command_s, bound=10.0, unit="s"),
        ],
        plots=[
            Plot(name="diagnosis", title="Diagnosis over trials", x_label="trials", y_label="time / s",
                 lines={"diagnose": (list(map(float, numbers)), seconds)}),
        ],
        numbers={"diagnosis_s": seconds[-1]},
    )  # fmt: skip
