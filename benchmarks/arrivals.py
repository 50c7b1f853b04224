"""Times of streams whose links are late, and losses that no counter shows: `python -m benchmarks.arrivals`.

Every pattern is drawn from its seed: rate, quartz, jitter, and one to three spells of lateness of up to 2 s, by up to
2 s; a second set loses samples on top, and in a third one the link is late as the stream begins. The command writes
docs/arrivals.md, and exits with 1 where a pattern breaks what the page promises.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.rigs.arrivals import SMALLEST_ERROR_S, START_S, late, rising, stalled, swelling, timed

PAGE = Path(__file__).parents[1] / "docs" / "arrivals.md"
N_PATTERNS = 40
LOST_AT_S, SECONDS = 13.0, 17.0
SHORTEST_LOSS_S, FOUND_WITHIN_S = 0.005, 2.0
# Instruments are read as they send at first, and after 3 s where their samples have gathered.
READ_EVERY_S = (0.0047, 0.0447)
SHAPES = {"late": late, "rising": rising, "swelling": swelling}


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """One draw: in words, and as what `tests.rigs.arrivals.timed` takes."""

    seed: int
    words: str
    rate_hz: float
    ppm: float
    jitter_s: float
    lateness: Callable[[float], float]

    @property
    def read_every_s(self) -> float:
        """Time between two reads, s."""
        return READ_EVERY_S[self.seed % 2]


def draw(seed: int, *, is_late_at_start: bool = False) -> Pattern:
    """Spells do not overlap and leave 1 s between them; they begin 1 s after the stream, or before it does.

    A link that is late by the same time from the first sample on looks like one that is not.
    """
    rng = np.random.default_rng([20261130 if is_late_at_start else 20260322, seed])
    rate_hz = float(rng.choice([1000.0, 6000.0, 10_000.0]))
    spells, words, at_s = [], [], -0.5 if is_late_at_start else 1.0
    for _ in range(int(rng.integers(1, 4))):
        at_s += float(rng.uniform(0.0, 1.0))
        lasts_s = float(np.exp(rng.uniform(np.log(0.05), np.log(2.0))))
        if rng.random() < 0.3:
            spells.append(stalled(lasts_s, at_s))
            words.append(f"stalled for {lasts_s:.2f} s")
        else:
            name = str(rng.choice([shape for shape in SHAPES if at_s > max(READ_EVERY_S) or shape != "late"]))
            by_s = float(np.exp(rng.uniform(np.log(0.005), np.log(2.0))))
            spells.append(SHAPES[name](by_s, lasts_s, at_s))
            words.append(f"{name} by {1e3 * by_s:.0f} ms for {lasts_s:.2f} s")
        at_s += lasts_s + 1.0
    return Pattern(
        seed=seed,
        words=", ".join(words),
        rate_hz=rate_hz,
        ppm=float(rng.uniform(-50, 50)),
        jitter_s=float(rng.uniform(3e-5, 3e-4)),
        lateness=lambda t: max(spell(t) for spell in spells),
    )


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the page; `problem` is empty where the promise holds."""

    cells: tuple[str, ...]
    problem: str


def without_loss(pattern: Pattern) -> Row:
    """No sample may move by more than one sample, and none be called lost; that they are late may be said."""
    found = timed(
        pattern.rate_hz, pattern.lateness, seconds=SECONDS, ppm=pattern.ppm, jitter_s=pattern.jitter_s,
        seed=pattern.seed, read_every_s=pattern.read_every_s,
    )  # fmt: skip
    worst_s = float(np.abs(found.error_s).max())
    said = [*found.losses, *found.doubts]
    is_wrong = worst_s > max(1.0 / pattern.rate_hz, SMALLEST_ERROR_S)
    problem = f"seed {pattern.seed}: {len(said)} said, worst {1e3 * worst_s:.2f} ms" if said or is_wrong else ""
    cells = (
        str(pattern.seed), f"{pattern.rate_hz:g}", pattern.words, f"{1e3 * worst_s:.3f}",
        f"{worst_s * pattern.rate_hz:.2f}",
        f"{len(said)} events" if said else "late" if found.n_late else "nothing",
    )  # fmt: skip
    return Row(cells=cells, problem=problem)


def with_loss(pattern: Pattern) -> Row:
    """A loss of 5 ms or more must be said, and the times behind it be right."""
    rng = np.random.default_rng([20260323, pattern.seed])
    lost_s = float(np.exp(rng.uniform(np.log(SHORTEST_LOSS_S), np.log(2.0))))
    n_lost = int(np.ceil(lost_s * pattern.rate_hz))
    found = timed(
        pattern.rate_hz, pattern.lateness, lost=[(LOST_AT_S, n_lost)], seconds=SECONDS + lost_s, ppm=pattern.ppm,
        jitter_s=pattern.jitter_s, seed=pattern.seed, read_every_s=pattern.read_every_s,
    )  # fmt: skip
    behind_s = float(np.abs(found.error_s[found.true_s > LOST_AT_S + lost_s]).max())
    n_said = sum(loss.n_missing for loss in found.losses)
    # Samples behind the loss tell of it: time counts from the first of them.
    behind_loss_s = [at_s - (LOST_AT_S + lost_s) for at_s in found.first_said_s]
    said_s = next((at_s for at_s in behind_loss_s if at_s > 0), np.inf)
    counted_s = max(found.loss_said_s, default=np.inf) - (LOST_AT_S + lost_s)
    place_s = max((abs(loss.start_s - START_S - LOST_AT_S) for loss in found.losses), default=np.inf)
    limit_s = 1.0 / pattern.rate_hz + SMALLEST_ERROR_S
    problems = [
        f"said {len(found.losses)} losses" if len(found.losses) != 1 else "",
        f"counted {n_said} of {n_lost}" if abs(n_said - n_lost) > 1 else "",
        f"said after {said_s:.2f} s" if said_s > FOUND_WITHIN_S else "",
        f"{1e3 * behind_s:.2f} ms off behind it" if behind_s > limit_s else "",
    ]
    cells = (
        str(pattern.seed), f"{pattern.rate_hz:g}", f"{1e3 * lost_s:.1f} ms, {n_lost}", str(n_said),
        f"{said_s:.2f}", f"{counted_s:.2f}", f"{1e3 * place_s:.1f}", f"{1e3 * behind_s:.3f}",
    )  # fmt: skip
    wrong = ", ".join(filter(None, problems))
    return Row(cells=cells, problem=f"seed {pattern.seed}: {wrong}" if wrong else "")


HEAD = """# Late links and losses

How well the common clock (`acquisition/clock.py`, `acquisition/stream_timing.py`) times a stream that has no counter
and whose link is late; `python -m benchmarks.arrivals` writes this page. Each pattern is drawn from its seed: rate,
quartz (+-50 ppm), jitter of the reads (mean 0.03 to 0.3 ms), and spells of lateness; even seeds are read every
4.7 ms, odd ones every 44.7 ms, as the recorder does at first and later. {summary}

A stream begins once its latest 0.4 s came as those of a quartz do, or its latest 2.1 s as those of a rate that the
instrument rounded; until then its samples wait, 5 s at most. What is late by the same time from the first sample on
cannot be told from a link's latency before it falls back into time; where it does, that is said.

A loss is only a loss when nothing has come in time for 2.1 s, as until then it may be a late link; the samples wait
until then. After 1.75 s it is said that they do, and by how much they are late ("late" below): a late link, or a loss.
What is shorter than 4 ms is not found by time, see [faults](faults.md).
"""


LATE_NAMES = ("seed", "rate, Hz", "spells", "worst error, ms", "in samples", "said")


def page(late_rows: list[Row], loss_rows: list[Row], start_rows: list[Row], summary: str) -> str:
    """The page as text."""
    parts = [HEAD.format(summary=summary)]
    for title, names, rows in (
        ("Late, nothing lost", LATE_NAMES, late_rows),
        (
            "The same, and samples lost at 13 s",
            (
                "seed",
                "rate, Hz",
                "lost",
                "counted",
                "said after, s",
                "counted after, s",
                "place off by, ms",
                "worst error behind it, ms",
            ),
            loss_rows,
        ),
        ("Late as the stream begins", LATE_NAMES, start_rows),
    ):
        lines = [f"## {title}", "", f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
        parts.append("\n".join([*lines, *(f"| {' | '.join(row.cells)} |" for row in rows)]) + "\n")
    return "\n".join(parts)


def main() -> int:
    """Time every pattern, write the page, say what broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patterns", type=int, default=N_PATTERNS)
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    patterns = [draw(seed) for seed in range(options.patterns)]
    starts = [draw(seed, is_late_at_start=True) for seed in range(options.patterns)]
    late_rows, loss_rows = ([judge(pattern) for pattern in patterns] for judge in (without_loss, with_loss))
    start_rows = [without_loss(pattern) for pattern in starts]
    problems = [row.problem for row in (*late_rows, *loss_rows, *start_rows) if row.problem]
    n_late, n_loss, n_start = (sum(not row.problem for row in rows) for rows in (late_rows, loss_rows, start_rows))
    summary = (
        f"Late without loss: {n_late} of {len(patterns)} patterns move no sample by more than one sample "
        f"(or {1e3 * SMALLEST_ERROR_S:g} ms) and call nothing lost. With a loss of 5 ms to 2 s: {n_loss} of "
        f"{len(patterns)} say so within {FOUND_WITHIN_S:g} s, and count one loss, to one sample, with right times "
        f"behind it. Late as the stream begins: {n_start} of {len(starts)} as without loss."
    )
    options.out.write_text(page(late_rows, loss_rows, start_rows, summary), encoding="utf-8")
    print("\n".join([str(options.out), summary, *problems]))
    return 1 if problems else 0


if __name__ == "__main__":
    raise SystemExit(main())
