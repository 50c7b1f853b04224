"""What each step of one recording costs, over known effects and over length; a plan for a million recordings."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import sawbench
from sawbench.analysis import runtime_of
from sawbench.inputs import default_config_path
from sawbench.reporting.trial_page import write_trial_page
from sawbench.trial_report import trial_report

from benchmarks.measuring import Clock, Plot, Section, Table, Timing, time_words

OAK = Path(__file__).parents[1] / "recordings" / "oak-01.mcap"
EFFECTS = (
    "guide_friction = { force_n = 5.0, std = 0.4 }",
    "windage_drag = { torque_at_1000_rad_s_n_m = 0.004, std = 0.001 }",
    "brush_voltage_drop = { voltage_v = 0.3, std = 0.05 }",
    "converter_diode_drop = { forward_voltage_v = 0.4, std = 0.05 }",
)
STARTED = datetime(2026, 3, 2, tzinfo=UTC)
MILLION, WORKERS, DAY_S = 1_000_000, 32, 86_400.0
# From 50 recordings on a batch compiles it.
BATCH_RUNTIME = "runtime, compiled"
Curves = dict[str, tuple[list[float], list[float]]]


def steps(clock: Clock, folder: Path, path: Path) -> dict[str, Timing]:
    """Time of each step of one recording, everything compiled."""
    opened = sawbench.read(path)
    trial = sawbench.process(opened)
    fit = sawbench.fit(trial)
    sawbench.runtime(fit)

    def page():
        write_trial_page(folder / "page.html", trial_report(trial), files={}, overwrite=True)

    return clock.together(
        {
            "read": lambda: sawbench.read(path),
            "process": lambda: sawbench.process(opened),
            "fit": lambda: sawbench.fit(trial),
            "runtime": lambda: sawbench.runtime(fit),
            BATCH_RUNTIME: lambda: runtime_of(trial, fit.cutting, fit.estimates, compiles=True),
            "page": page,
        },
        seconds=1.0,
    )


def over_effects(
    clock: Clock, folder: Path
) -> tuple[list[tuple[str, ...]], dict[str, tuple[list[float], list[float]]]]:
    """Rows and curves of a simulated second, a fit and a runtime over the number of known effects."""
    text = default_config_path().read_text(encoding="utf-8")
    rows: list[tuple[str, ...]] = []
    lines: Curves = {name: ([], []) for name in ("simulate", "fit", "runtime")}
    for n in range(len(EFFECTS) + 1):
        path = folder / f"effects-{n}.toml"
        path.write_text("\n".join([text, "[effects]", *EFFECTS[:n]]) if n else text, encoding="utf-8")
        trial = sawbench.process(OAK, config=path)
        fit = sawbench.fit(trial)
        found = clock.together(
            {
                "simulate": lambda path=path: sawbench.simulate(config=path),
                "fit": lambda trial=trial: sawbench.fit(trial),
                "runtime": lambda fit=fit: sawbench.runtime(fit),
            },
            seconds=0.2, least=2,
        )  # fmt: skip
        rows.append((str(n), *map(str, found.values())))
        for name, timing in found.items():
            lines[name][0].append(float(n))
            lines[name][1].append(timing.median_s)
    return rows, lines


def long_recording(path: Path, seconds: float) -> int:
    """Write a simulated trial of 10 kHz a channel; returns its number of samples."""
    from sawbench.bench.recording import SampleBlock
    from sawbench.storage.writer import RecordingWriter

    made = sawbench.simulate(duration_s=seconds, rate_hz=10_000.0).recording().recording
    text = default_config_path().read_text(encoding="utf-8")
    with RecordingWriter(path=path, trial=made.trial, config_toml=text, provenance={}, started_at=STARTED) as writer:
        for name, signal in made.signals.items():
            writer.write_block(
                SampleBlock(device="model", channel=name, unit=signal.unit, first_index=0, time_s=signal.time_s,
                            values=signal.values, period_s=1e-4)
            )  # fmt: skip
    return sum(len(signal.values) for signal in made.signals.values())


def measure(clock: Clock) -> Section:
    """Steps of a shipped trial and of a longer one, and the growth with known effects."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        n_long = long_recording(folder / "long.mcap", 10.0)
        short, long = steps(clock, folder, OAK), steps(clock, folder, folder / "long.mcap")
        rows, lines = over_effects(clock, folder)
    return Section(
        title="One recording",
        words=["Everything compiled, on one thread; what a first call costs is under Commands."],
        tables=[
            Table(
                head=("step", "shipped trial, 2 s, 30 000 samples", f"simulated trial, 10 s, {n_long} samples"),
                rows=[(name, str(short[name]), str(long[name])) for name in short],
            ),
            Table(
                title="With known effects in the model",
                head=("effects", "simulate 1 s", "fit", "runtime"),
                rows=rows,
            ),
        ],
        plots=[
            Plot(name="effects", title="Known effects in the model", x_label="effects", y_label="time / s",
                 lines=lines),
        ],
        numbers={f"{name}_s": timing.median_s for name, timing in long.items()} | {"samples": float(n_long)},
    )  # fmt: skip


def plan(numbers: Mapping[str, float]) -> Section:
    """A million recordings of 10 s: computing time, storage and writing, from measured cost.

    `numbers` holds those of this section and `bytes_a_sample` of the storage.
    """
    steps_s = {name: numbers[f"{name}_s"] for name in ("read", "process", "fit", BATCH_RUNTIME)}
    whole_s = sum(steps_s.values())
    terabytes = MILLION * numbers["samples"] * numbers["bytes_a_sample"] / 1e12
    days = MILLION * whole_s / DAY_S
    rows = [(name, time_words(spent), f"{MILLION * spent / DAY_S:.2g} days") for name, spent in steps_s.items()]
    rows.append(("`process --archive`", time_words(whole_s), f"{days:.2g} days"))
    page_s = numbers["page_s"]
    rows.append(("a page each, where wanted", time_words(page_s), f"{MILLION * page_s / DAY_S:.2g} days"))
    mb_s = terabytes * 1e6 / (days * DAY_S / WORKERS)
    return Section(
        title="A plan for a million recordings",
        words=[
            f"Trials of 10 s with {numbers['samples']:.0f} samples each. Recordings share nothing, so workers divide "
            f"the work: {WORKERS} cores need {24 * days / WORKERS:.2g} hours for `process --archive` and read "
            f"{mb_s:.0f} MB/s. Storage: {terabytes:.2g} TB.",
            "A new version of the model evaluates all of them again. A row takes some 20 kB of memory when read: "
            "100 000 recordings an archive, by year or laboratory, keep `compare` within 2 GB.",
        ],
        tables=[Table(head=("step", "one recording", "a million, one core"), rows=rows)],
    )
