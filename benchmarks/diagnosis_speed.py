"""Time of a diagnosis over trials and known effects; its accuracy against the peers stands in docs/peers.md."""

from __future__ import annotations

import re
import tempfile
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
# Rows of docs/peers.md that say most.
ROWS = (
    "exact effect, typical single effects",
    "false alarms: an effect is claimed, none or parameters only",
    "called unknown, effects outside the catalogue",
    "log-loss / nats",
    "time a case, median / s",
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
    """Recordings of a campaign of 18 trials with guide friction, and its configuration."""
    make_campaign(SEED, folder, effects={"guide_friction": 1.0}, length=length)
    paths = import_path(folder / "campaign.toml", folder / "imported").paths
    return [read_recording(path) for path in paths], load_config(folder / "bench_config.toml")


def measure(clock: Clock) -> Section:
    """Time of `diagnose` without page over the number of trials, on one thread."""
    with tempfile.TemporaryDirectory() as place:
        recordings, loaded = campaign(Path(place) / "campaign", 0.25 if clock.quick else 1.0)
    rows, numbers, seconds = [], (6, 12, 18), []
    with threadpool_limits(limits=1, user_api="blas"):
        diagnose(recordings[: numbers[0]], loaded, provenance={})  # compiles
        for n in numbers:
            report = {}
            seconds.append(
                clock.once(lambda n=n, report=report: report.update(diagnose(recordings[:n], loaded, provenance={})))
            )
            n_samples = sum(len(s.values) for recording in recordings[:n] for s in recording.signals.values())
            rows.append((str(n), f"{n_samples / 1e6:.2f} million", f"{seconds[-1]:.1f} s", report["verdict"]))
    return Section(
        title="Diagnosis",
        words=[
            "A campaign of the blind check with guide friction, diagnosed on one thread, page not counted. All effects "
            "of the catalogue are weighed every time, so the number of trials decides the cost."
        ],
        tables=[Table(head=("trials", "samples", "time", "verdict"), rows=rows), accuracy()],
        goals=[Goal(what="diagnosis of 18 trials", value=seconds[-1], bound=15.0, unit="s")],
        plots=[
            Plot(name="diagnosis", title="Diagnosis over trials", x_label="trials", y_label="s",
                 lines={"diagnose": (list(map(float, numbers)), seconds)}),
        ],
        numbers={"diagnosis_s": seconds[-1]},
    )  # fmt: skip
