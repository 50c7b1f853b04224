"""Features of whole sets, one file a case: of sealed sets, and of development campaigns that are thrown away."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.blindcheck.answering import refuse_key_inside
from sawbench.blindcheck.sealing import COMMITMENTS, draw_cases, read_json, write_json

from benchmarks.diagnosis_peers.hypotheses import label_of
from benchmarks.diagnosis_peers.reduction import read_campaign, reduce
from benchmarks.diagnosis_peers.terms import Terms, terms_of
from benchmarks.diagnosis_peers.vector import feature_vector

LAST_DEVELOPMENT_SEED = 999
LABELS = "labels.json"
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseFeatures:
    """What is kept of one campaign.

    Attributes
    ----------
    vector : ndarray, shape (n,)
        Of `vector.feature_vector`.
    vector_time_s : float
        Reading, reducing and laying out.
    terms : Terms or None
        None where only the vector was wanted.
    terms_time_s : float
        The same with the dictionary.
    """

    vector: Floats
    vector_time_s: float
    terms: Terms | None = None
    terms_time_s: float = 0.0


def features_of(case_dir: Path, *, with_terms: bool = True) -> CaseFeatures:
    """Read and reduce one campaign.

    Parameters
    ----------
    case_dir : Path
        With `campaign.toml`.
    with_terms : bool
        Also build the dictionary, which takes most of the time.

    Returns
    -------
    CaseFeatures
    """
    begun = time.perf_counter()
    reduced = reduce(*read_campaign(case_dir))
    vector = feature_vector(reduced)
    vector_time_s = time.perf_counter() - begun
    if not with_terms:
        return CaseFeatures(vector=vector, vector_time_s=vector_time_s)
    terms = terms_of(reduced)
    return CaseFeatures(
        vector=vector, vector_time_s=vector_time_s, terms=terms, terms_time_s=time.perf_counter() - begun
    )


def save(path: Path, features: CaseFeatures) -> None:
    """Write through a temporary file, so that a broken-off run leaves nothing half."""
    content: dict[str, Any] = {"vector": features.vector, "vector_time_s": features.vector_time_s}
    if features.terms is not None:
        content |= {
            "names": np.array(features.terms.names), "gram": features.terms.gram,
            "rows": features.terms.rows.astype(np.float32), "n_samples": features.terms.n_samples,
            "terms_time_s": features.terms_time_s,
        }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, **content)
    part.replace(path)


def load(path: Path) -> CaseFeatures:
    """Read what `save` wrote.

    Raises
    ------
    InputError
        If there is no such file.
    """
    if not path.exists():
        raise InputError("has no features", where=path, remedy="run the step `features` or `develop` first")
    with np.load(path) as found:
        vector, vector_time_s = found["vector"], float(found["vector_time_s"])
        if "gram" not in found:
            return CaseFeatures(vector=vector, vector_time_s=vector_time_s)
        terms = Terms(
            names=tuple(map(str, found["names"])), gram=found["gram"], rows=found["rows"].astype(np.float64),
            n_samples=int(found["n_samples"]),
        )  # fmt: skip
        return CaseFeatures(
            vector=vector, vector_time_s=vector_time_s, terms=terms, terms_time_s=float(found["terms_time_s"])
        )


def peers_dir(set_dir: Path) -> Path:
    """Folder beside a set for all that belongs to the peers."""
    set_dir = Path(set_dir)
    return set_dir.with_name(set_dir.name + ".peers")


def features_of_set(
    set_dir: Path,
    *,
    n_cases: int | None = None,
    first: int = 0,
    every: int = 1,
    on_progress: Progress | None = None,
) -> list[str]:
    """Reduce every case of a sealed set that is not reduced yet; the key stays closed.

    Parameters
    ----------
    set_dir : Path
    n_cases : int, optional
        Only the first so many by name.
    first, every : int
        Do every so many-th case from the first on: for several processes side by side.
    on_progress : callable, optional
        (done, wanted, case).

    Returns
    -------
    list of str
        Cases that cannot be reduced; they have no answer of any peer.
    """
    set_dir = Path(set_dir)
    refuse_key_inside(set_dir)
    names = sorted(read_json(set_dir / COMMITMENTS)["cases"])[:n_cases]
    failed = []
    for done in range(first, len(names), every):
        name = names[done]
        path = peers_dir(set_dir) / "features" / f"{name}.npz"
        if not path.exists():
            try:
                save(path, features_of(set_dir / name))
            except InputError as error:
                failed.append(f"{name}: {error}")
        if on_progress is not None:
            on_progress(done + 1, len(names), name)
    return failed


def develop(
    seed: int,
    n_cases: int,
    out_dir: Path,
    *,
    n_with_terms: int = 60,
    length: float = 1.0,
    first: int = 0,
    every: int = 1,
    on_progress: Progress | None = None,
) -> None:
    """Make campaigns to train on, keep their features and labels, and throw the campaigns away; resumable.

    Parameters
    ----------
    seed : int
        1 to 999.
    n_cases : int
        Drawn as `sawbench blind make` draws them.
    out_dir : Path
    n_with_terms : int
        Cases that also get the dictionary, for the settings of the peers that use it.
    length : float
        Factor on the duration of every trial; 1 is what the sealed sets have.
    first, every : int
        Do every so many-th case from the first on: for several processes side by side.
    on_progress : callable, optional

    Raises
    ------
    InputError
        If the seed is one of a claim.
    """
    from sawbench.blindcheck.campaign import make_campaign

    if not 1 <= seed <= LAST_DEVELOPMENT_SEED:
        raise InputError(f"seed is {seed}, allowed for training is 1 to {LAST_DEVELOPMENT_SEED}")
    out_dir = Path(out_dir)
    specs = draw_cases(seed, n_cases)
    for number in range(first, n_cases, every):
        spec = specs[number]
        path = out_dir / f"{spec.name}.npz"
        if not path.exists():
            with tempfile.TemporaryDirectory(prefix="peers-") as folder:
                case_dir = Path(folder) / "campaign"
                parameters = "beyond" if spec.kind == "parameters" else "within"
                make_campaign(spec.seed, case_dir, effects=spec.effects, parameters=parameters, length=length)
                save(path, features_of(case_dir, with_terms=number < n_with_terms))
        if on_progress is not None:
            on_progress(number + 1, n_cases, spec.name)
    labels = {spec.name: {"kind": spec.kind, "effects": dict(spec.effects)} for spec in specs}
    write_json(out_dir / LABELS, {"seed": seed, "length": length, "cases": labels})


def development_cases(folders: list[Path]) -> Iterator[tuple[dict[str, Any], CaseFeatures]]:
    """Label ("kind", "effects", "class") and features of every development case that is there.

    Raises
    ------
    InputError
        If a folder has no labels, or those of a seed that claims rest on.
    """
    for folder in folders:
        found = read_json(Path(folder) / LABELS)
        if not 1 <= found["seed"] <= LAST_DEVELOPMENT_SEED:
            raise InputError(f"was made with seed {found['seed']}, allowed is 1 to 999", where=folder)
        for name, label in sorted(found["cases"].items()):
            path = Path(folder) / f"{name}.npz"
            if path.exists():
                yield {**label, "class": label_of(label["kind"], label["effects"])}, load(path)
