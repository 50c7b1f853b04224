"""What is in an `.rrd` file, read without the viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun.chunk as rr_chunk


def read_rrd(path: Path) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
    """Return time (s) and value of every scalar entity in an .rrd file."""
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for chunk in rr_chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if "Scalars:scalars" in name]
        if names and "time" in batch.schema.names:
            time_s = np.array(batch.column("time").cast("int64").to_pylist()) / 1e9
            values = np.array([row[0] for row in batch.column(names[0]).to_pylist()])
            found.setdefault(chunk.entity_path.strip("/"), []).append((time_s, values))
    return found


def joined(found, path):
    time_s, values = (np.concatenate(parts) for parts in zip(*found[path], strict=True))
    order = np.argsort(time_s, kind="stable")
    return time_s[order], values[order]


def times_and_texts(path: Path) -> tuple[dict[str, list[float]], list[str]]:
    """Return the times of every entity, s, and the texts of all events."""
    times: dict[str, list[float]] = {}
    texts: list[str] = []
    for chunk in rr_chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if "time" in batch.schema.names:
            at_s = np.array(batch.column("time").cast("int64").to_pylist()) / 1e9
            times.setdefault(chunk.entity_path.strip("/"), []).extend(at_s.tolist())
        for name in batch.schema.names:
            if "TextLog:text" in name:
                texts += [row[0] for row in batch.column(name).to_pylist()]
    return times, texts


def texts_of(path: Path) -> str:
    """Return what stands in the text panels, the legends and the titles of the panels, a line each."""
    reader = rr_chunk.RrdReader(path)
    found: list[str] = []
    for store in (None, *reader.blueprints()):
        for chunk in reader.stream(store=store):
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name.endswith((":text", ":names", ":display_name")):
                    found += [text for row in batch.column(name).to_pylist() if row for text in row]
    return "\n".join(found)
