"""Recordings altered in every way that comes to mind: `python -m benchmarks.corruptions --count 10000`.

One recording is written, and altered again from every seed: bits, bytes, ranges, chunks, lengths, sectors, the end, a
chunk of another recording, a decompression bomb, another file behind it; one in seven gets two of these. Each altered
file is read; what comes out is compared with what was written. The command exits with 1 where anything wrong went
unsaid.
"""

from __future__ import annotations

import argparse
import json
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from sawbench.bench.errors import SawbenchError
from sawbench.bench.recording import Event, Recording, SampleBlock, Trial
from sawbench.storage.describe import describe_recording
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

STARTED_AT = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
LONGEST_S = 2.0
# A hang ends here; processor time decides, as other programs may keep the machine busy.
GIVEN_UP_S = 120
RATE_HZ, SECONDS = 1000, 4
CHUNK, HEAD = 0x06, 9
# Of what is said where samples may be others than those that were recorded.
DOUBT = ("not verified", "cannot be read", "left out", "checksum", "damaged", "are not read", "claims", "lost")


def write_base(path: Path, *, seed: int) -> None:
    """Two channels and some events, in one chunk a second; values tell channel, recording and sample."""
    now_s = [0.0]
    trial = Trial(trial_id=f"T{seed}", material="oak", duty=0.4375, thickness_mm=20.0, notes="as written")
    with RecordingWriter(
        path=path, trial=trial, config_toml="[cutting]\ncutting_half = 'pi_to_2pi'\n", provenance={"clock": "host"},
        started_at=STARTED_AT, clock=lambda: now_s[0],
    ) as writer:  # fmt: skip
        rng = np.random.default_rng(seed)
        for k in range(10 * SECONDS):
            index = np.arange(100 * k, 100 * k + 100)
            for n, (channel, unit) in enumerate((("force_n", "N"), ("displacement_mm", "mm"))):
                values = index + 1e5 * n + 1e6 * seed + rng.random(len(index))
                writer.write_block(
                    SampleBlock(
                        device="cell", channel=channel, unit=unit, first_index=100 * k, time_s=index / RATE_HZ,
                        values=values, raw=values * 2, period_s=1 / RATE_HZ,
                    )
                )  # fmt: skip
            if k % 7 == 0:
                writer.write_event(Event(kind="note", time_s=k / 10, text=f"note {k}"))
            now_s[0] += 0.1


Bytes = bytes | bytearray


def chunks(content: Bytes) -> list[tuple[int, int]]:
    """Start and end of every chunk record, by the format's framing."""
    found, at = [], 8
    while at + HEAD <= len(content) and content[at : at + 5] != b"\x89MCAP":
        end = at + HEAD + int.from_bytes(content[at + 1 : at + HEAD], "little")
        if content[at] == CHUNK and end <= len(content):
            found.append((at, end))
        at = end
    return found


def chunk_record(data: bytes, *, unpacked: int, crc: int = 0) -> bytes:
    """A chunk, written from the format's description."""
    body = struct.pack("<QQQI", 0, 1, unpacked, crc) + struct.pack("<I", 4) + b"zstd"
    body += struct.pack("<Q", len(data)) + data
    return bytes((CHUNK,)) + struct.pack("<Q", len(body)) + body


BOMB = zstandard.compress(bytes(1 << 28))


class Alterations:
    """What can be done to a file; each takes its bytes and returns others."""

    def __init__(self, other: bytes) -> None:
        self._other = other

    def names(self) -> list[str]:
        return [name for name in dir(self) if not name.startswith("_") and name != "names"]

    def flip_a_bit(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        return content

    def garble_a_range(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        at, n = int(rng.integers(len(content))), int(rng.integers(1, 300))
        content[at : at + n] = rng.bytes(len(content[at : at + n]))
        return content

    def zero_a_sector(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        at = 512 * int(rng.integers(len(content) // 512))
        content[at : at + 512] = bytes(len(content[at : at + 512]))
        return content

    def cut_off(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        return content[: int(rng.integers(len(content)))]

    def take_a_range_out(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        at = int(rng.integers(len(content)))
        del content[at : at + int(rng.integers(1, 3000))]
        return content

    def put_bytes_in(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        at = int(rng.integers(len(content)))
        return content[:at] + rng.bytes(int(rng.integers(1, 500))) + content[at:]

    def double_a_range(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        at, n = int(rng.integers(len(content))), int(rng.integers(1, 5000))
        return content[: at + n] + content[at : at + n] + content[at + n :]

    def take_a_chunk_out(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        start, end = _one_of(chunks(content), rng)
        return content[:start] + content[end:]

    def double_a_chunk(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        start, end = _one_of(chunks(content), rng)
        return content[:end] + content[start:end] + content[end:]

    def exchange_chunks(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        rows = chunks(content)
        if len(rows) < 2:
            return content
        (a, b), (c, d) = sorted(rows[int(k)] for k in rng.choice(len(rows), 2, replace=False))
        return content[:a] + content[c:d] + content[b:c] + content[a:b] + content[d:]

    def chunk_of_another_recording(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        (start, end), (a, b) = _one_of(chunks(content), rng), _one_of(chunks(self._other), rng)
        return content[:start] + self._other[a:b] + content[end:]

    def chunk_of_another_recording_more(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        (_, end), (a, b) = _one_of(chunks(content), rng), _one_of(chunks(self._other), rng)
        return content[:end] + self._other[a:b] + content[end:]

    def checksum_off_and_altered(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        """The samples of a chunk changed by somebody who takes its checksum away."""
        start, end = _one_of(chunks(content), rng)
        body = content[start + HEAD : end]
        n_name = int.from_bytes(body[28:32], "little")
        data = bytearray(zstandard.decompress(bytes(body[40 + n_name :]), max_output_size=1 << 24))
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        return content[:start] + chunk_record(zstandard.compress(bytes(data)), unpacked=len(data)) + content[end:]

    def bomb(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        start, _ = _one_of(chunks(content), rng)
        claimed = int(rng.choice([1 << 28, 100, 0, 1 << 40]))
        return content[:start] + chunk_record(BOMB, unpacked=claimed) + content[start:]

    def length_of_a_chunk(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        start, _ = _one_of(chunks(content), rng)
        length = (0, 7, 1 << 20, 1 << 40, (1 << 64) - 1)[int(rng.integers(5))]
        content[start + 1 : start + HEAD] = struct.pack("<Q", length)
        return content

    def another_file_behind(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        return content + (self._other if rng.random() < 0.5 else bytes(content))

    def other_file_in_the_middle(self, content: bytearray, rng: np.random.Generator) -> Bytes:
        start, _ = _one_of(chunks(content), rng)
        return content[:start] + self._other + content[start:]


def _one_of(rows: list[tuple[int, int]], rng: np.random.Generator) -> tuple[int, int]:
    return rows[int(rng.integers(len(rows)))] if rows else (8, 8)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What one altered file led to; `wrong` is empty where all is said."""

    seed: int
    kinds: tuple[str, ...]
    outcome: str
    wrong: str
    seconds: float


def judge(before: Recording, path: Path) -> tuple[str, str]:
    """Outcome and what is wrong with it."""
    try:
        after = read_recording(path)
        info = describe_recording(path)
    except SawbenchError as error:
        return ("refused", "" if str(path) in str(error) else f"refused without a name: {error}")
    said = [*info.problems, *(e.text for e in after.events if e.kind in {"gap", "warning", "interrupted"})]
    foreign, n_kept = 0, 0
    for channel, found in after.signals.items():
        own = before.signals.get(channel)
        known = set() if own is None else set(zip(own.time_s.tolist(), own.values.tolist(), strict=True))
        rows = set(zip(found.time_s.tolist(), found.values.tolist(), strict=True))
        foreign, n_kept = foreign + len(rows - known), n_kept + len(rows & known)
    n_before = sum(len(signal.time_s) for signal in before.signals.values())
    notes = [[(e.time_s, e.text) for e in recording.events if e.kind == "note"] for recording in (before, after)]
    is_same = (
        not foreign
        and n_kept == n_before
        and notes[0] == notes[1]
        and (before.trial, before.config_toml, before.provenance) == (after.trial, after.config_toml, after.provenance)
    )
    if after.is_complete != info.is_complete:
        return "altered", "info and reader disagree on whether it is complete"
    if is_same:
        return ("same, said" if said else "same", "")
    if after.is_complete or not said:
        return (
            "altered",
            f"unsaid: {foreign} foreign samples, {n_kept} of {n_before} kept, complete: {after.is_complete}",
        )
    if foreign and not any(word in text for text in said for word in DOUBT):
        return "altered", f"{foreign} foreign samples verified: {'; '.join(said)}"
    return ("foreign samples, said" if foreign else "less, said"), ""


def run(count: int, *, first_seed: int = 0, progress: Callable[[int], object] = lambda _: None) -> list[Verdict]:
    """Alter and judge `count` times."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        base, other, path = (Path(folder) / name for name in ("base.mcap", "other.mcap", "altered.mcap"))
        write_base(base, seed=1)
        write_base(other, seed=2)
        before, content = read_recording(base), base.read_bytes()
        if not before.is_complete or len(chunks(content)) < SECONDS:
            raise SystemExit("the recording to be altered is not as it should be")
        alterations = Alterations(other.read_bytes())
        for seed in range(first_seed, first_seed + count):
            rng = np.random.default_rng([20260324, seed])
            kinds = tuple(str(k) for k in rng.choice(alterations.names(), 2 if rng.random() < 1 / 7 else 1))
            altered: Bytes = content
            for kind in kinds:
                # The first one may leave nothing that the second one knows.
                with suppress(ValueError, zstandard.ZstdError):
                    altered = getattr(alterations, kind)(bytearray(altered), rng)
            path.write_bytes(altered)
            found.append(_judged(before, path, seed, kinds))
            progress(seed)
    return found


def _judged(before: Recording, path: Path, seed: int, kinds: tuple[str, ...]) -> Verdict:
    def give_up(*_: Any) -> None:
        raise TimeoutError

    former = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(GIVEN_UP_S)
    begun_s = time.process_time()
    try:
        outcome, wrong = judge(before, path)
    except TimeoutError:
        outcome, wrong = "hang", f"not done after {GIVEN_UP_S} s"
    except Exception as error:
        outcome, wrong = "error", repr(error)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, former)
    seconds = time.process_time() - begun_s
    if not wrong and seconds > LONGEST_S:
        wrong = f"took {seconds:.1f} s of the processor"
    return Verdict(seed=seed, kinds=kinds, outcome=outcome, wrong=wrong, seconds=seconds)


def main() -> int:
    """Alter, judge, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()

    def progress(seed: int) -> None:
        if seed % 500 == 499:
            print(seed + 1, file=sys.stderr, flush=True)

    found = run(options.count, first_seed=options.first_seed, progress=progress)
    wrong = [verdict for verdict in found if verdict.wrong]
    table = Counter((kind, verdict.outcome) for verdict in found for kind in verdict.kinds)
    print(
        json.dumps(
            {
                "count": len(found),
                "outcomes": dict(Counter(verdict.outcome for verdict in found)),
                "longest_s": max(verdict.seconds for verdict in found),
                "by_kind": {f"{kind}: {outcome}": n for (kind, outcome), n in sorted(table.items())},
                "n_wrong": len(wrong),
                "wrong": [asdict(verdict) for verdict in wrong[:50]],
            },
            indent=1,
        )
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
