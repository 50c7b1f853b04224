"""Campaigns of the blind check's plant for benchmarks of the diagnosis: made, imported and read in one go."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.bench.config import LoadedConfig, load_config
from sawbench.bench.recording import Recording
from sawbench.blindcheck.campaign import make_campaign
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.plants.choice import reduce_recordings
from sawbench.storage.importers.dispatch import import_path
from sawbench.storage.reader import read_recording

# Seeds beyond it are for claims.
LAST_SEED: Final = 999


@dataclass(frozen=True, kw_only=True, slots=True)
class BlindCampaign:
    """Recordings, the configuration that states nothing of what is hidden, and what is hidden."""

    recordings: list[Recording]
    loaded: LoadedConfig
    truth: Mapping[str, Any]

    def reduced(self) -> Campaign:
        """Reduce the recordings."""
        return reduce_recordings(self.recordings, self.loaded)


def blind_campaign(
    seed: int, effects: Mapping[str, float], *, length: float = 1.0, repetition: int = 0, **drawn: Any
) -> BlindCampaign:
    """Simulate and read one campaign.

    Parameters
    ----------
    seed : int
    effects : mapping of str to float
        Severity by effect, 1 is typical.
    length : float
        Factor on the duration of every trial.
    repetition : int
        From 1 on the same machine is measured again.
    **drawn
        Further arguments of `make_campaign`: parameters, benches, and so on.
    """
    with tempfile.TemporaryDirectory() as folder:
        tables = Path(folder) / "tables"
        truth = make_campaign(seed, tables, effects=effects, length=length, repetition=repetition, **drawn)
        recordings, loaded = read_back(tables)
    return BlindCampaign(recordings=recordings, loaded=loaded, truth=truth)


def read_back(tables: Path) -> tuple[list[Recording], LoadedConfig]:
    """Import the tables of a campaign and read its recordings, which then need no file."""
    found = import_path(tables / "campaign.toml", tables.with_name("mcap"))
    return [read_recording(path) for path in found.paths], load_config(tables / "bench_config.toml")


def kept_cases(
    out: Path, kind: str, seeds: range, make: Callable[[int], dict[str, Any]], *, may_begin: Callable[[], bool]
) -> Iterator[dict[str, Any]]:
    """Cases of a benchmark, each kept as `OUT/KIND-SEED.json`: what is there already is read, not made again.

    Parameters
    ----------
    out : Path
    kind : str
    seeds : range
        Development seeds.
    make : callable
        seed -> what is kept of it.
    may_begin : callable
        Whether one more case is made; the first refusal ends it.
    """
    if seeds.stop - 1 > LAST_SEED:
        raise SystemExit(f"seeds above {LAST_SEED} are for claims: begin earlier, or ask for fewer cases")
    out.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        path = out / f"{kind}-{seed}.json"
        if not path.exists():
            if not may_begin():
                return
            path.write_text(json.dumps(make(seed)), encoding="utf-8")
        yield json.loads(path.read_text(encoding="utf-8"))


def severity(rng: np.random.Generator) -> float:
    """Draw a size over the typical one: 0.5 to 2, even in its logarithm."""
    return round(float(np.exp(rng.uniform(np.log(0.5), np.log(2.0)))), 3)
