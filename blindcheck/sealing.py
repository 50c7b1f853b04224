"""Sealed sets of cases: the campaigns and a commitment to every label in the open, the labels in a key.

A commitment is SHA-256(salt || label) over the label's canonical JSON. Salts are random, so that a label
cannot be found by trying; the open file also holds the hash of every file of the case, and the key the hash
of the open file, so that neither can be changed later without being found.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import secrets
import shutil
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.blindcheck.bench import Nature
from sawbench.blindcheck.effects.table import ACTS_IN, DrawnFrom, drawn_from
from sawbench.storage.output import write_whole

COMMITMENTS = "commitments.json"
SCHEMA_VERSION = 1
_SHARES: Mapping[str, float] = MappingProxyType(
    {"none": 0.125, "parameters": 0.125, "effect": 0.5, "pair": 0.1, "outside": 0.15}
)
_KIND_OF_COUNT: Mapping[int, str] = MappingProxyType({0: "none", 1: "effect", 2: "pair"})


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseSpec:
    """What a case hides.

    Attributes
    ----------
    name : str
        Folder of the case.
    kind : {"none", "parameters", "effect", "pair", "several", "outside"}
    effects : mapping of str to float
        Severity by effect id; empty for "none" and "parameters".
    seed : int
        Of `campaign.make_campaign`.
    """

    name: str
    kind: str
    effects: Mapping[str, float]
    seed: int


def draw_cases(
    seed: int, n_cases: int, tables: DrawnFrom | None = None, *, effects_per_case: int | None = None
) -> tuple[CaseSpec, ...]:
    """Draw what every case hides; cases are independent, and the first n do not depend on how many follow.

    The shares are 25 % without an effect (half of them with constants beyond their uncertainty), 50 % one
    effect, 10 % two, 15 % outside the catalogue. Severity is log-uniform in 0.5..2 (80 %), 0.1..0.5 or 2..3
    (10 % each). `tables` says which effects: of the first sets unless given.

    Examples
    --------
    >>> [case.name for case in draw_cases(1, 2)]
    ['case-0001', 'case-0002']
    >>> draw_cases(1, 5)[1] == draw_cases(1, 2)[1]
    True
    """
    children = np.random.SeedSequence(seed).spawn(n_cases)
    tables = tables or drawn_from()
    names = [f"case-{k:04d}" for k in range(1, n_cases + 1)]
    if effects_per_case is not None:
        return tuple(
            _draw_several(name, child, tables, effects_per_case) for name, child in zip(names, children, strict=True)
        )
    return tuple(_draw_case(name, child, tables) for name, child in zip(names, children, strict=True))


def _draw_several(name: str, child: np.random.SeedSequence, tables: DrawnFrom, count: int) -> CaseSpec:
    """Draw effects until no two of them act in one equation."""
    rng = np.random.default_rng(child)
    chosen: list[str] = []
    for effect in map(str, rng.permutation(list(tables.catalogue))):
        if len(chosen) < count and not any(ACTS_IN[effect] & ACTS_IN[other] for other in chosen):
            chosen.append(effect)
    if len(chosen) < count:
        return _draw_several(name, child.spawn(1)[0], tables, count)
    effects = {effect: _in_range(rng, 0.5, 2.0) for effect in chosen}
    kind = _KIND_OF_COUNT.get(count, "several")
    return CaseSpec(name=name, kind=kind, effects=effects, seed=int(rng.integers(2**62)))


def _draw_case(name: str, child: np.random.SeedSequence, tables: DrawnFrom) -> CaseSpec:
    rng = np.random.default_rng(child)
    kind = str(rng.choice(list(_SHARES), p=list(_SHARES.values())))
    table = list(tables.outside if kind == "outside" else tables.catalogue)
    count = {"effect": 1, "pair": 2, "outside": 1}.get(kind, 0)
    chosen = [str(effect) for effect in rng.choice(table, size=count, replace=False)]
    effects = {effect: _draw_severity(rng) for effect in chosen}
    return CaseSpec(name=name, kind=kind, effects=effects, seed=int(rng.integers(2**62)))


def _draw_severity(rng: np.random.Generator) -> float:
    low, high = ((0.5, 2.0), (0.1, 0.5), (2.0, 3.0))[int(rng.choice(3, p=[0.8, 0.1, 0.1]))]
    return _in_range(rng, low, high)


def _in_range(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 4)


# Size: options by name, those of `sawbench blind make`.
def make(
    seed: int,
    n_cases: int,
    out_dir: Path,
    *,
    nature: Nature | None = None,
    catalogue: Collection[str] = (),
    effects_per_case: int | None = None,
    key_path: Path | None = None,
    workers: int | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Make a sealed set of cases; a run that was broken off continues where it stopped.

    Parameters
    ----------
    seed : int
        Decides everything but the salts. Whoever knows it can make the labels again: keep it with the key.
    n_cases : int
    out_dir : Path
        Gets one folder per case and `commitments.json`.
    nature : Nature, optional
    catalogue : collection of str
        Ids that the diagnosis at hand lists; of foreign benches, others are hidden as outside the catalogue.
    effects_per_case : int, optional
        Hide that many effects in every case, see `draw_cases`; at most 4.
    key_path : Path, optional
        Where the labels go; beside `out_dir`, with `.key.json` added to its name, unless given. Never inside.
    workers : int, optional
        Processes; one per core unless given.
    on_progress : callable, optional
        Called with the number of cases done and the number wanted.

    Returns
    -------
    Path
        The key.

    Raises
    ------
    InputError
        If the key lies inside the set, belongs to another set, or the settings differ from the first run.
    """
    out_dir = Path(out_dir)
    nature = nature or Nature()
    key_path = Path(key_path) if key_path else out_dir.with_name(out_dir.name + ".key.json")
    _refuse(n_cases, out_dir, key_path)
    out_dir.mkdir(parents=True, exist_ok=True)
    tables = drawn_from(catalogue) if nature.benches == "foreign" else drawn_from()
    specs = draw_cases(seed, n_cases, tables, effects_per_case=effects_per_case)
    options = asdict(nature) | {"without": list(nature.without), "catalogue": list(tables.catalogue)}
    if effects_per_case is not None:
        options["effects_per_case"] = effects_per_case
    key = _open_key(key_path, out_dir, seed, options)
    done = sum(spec.name in key["cases"] for spec in specs)
    waiting = [spec for spec in specs if spec.name not in key["cases"]]
    _clear(waiting, out_dir)
    for name, label in _labels(waiting, out_dir, nature, workers or os.cpu_count() or 1):
        key["cases"][name] = {"salt": secrets.token_hex(32), "label": label}
        write_json(key_path, key)
        done += 1
        if on_progress is not None:
            on_progress(done, n_cases)
    _seal(out_dir, key_path, key)
    return key_path


def _refuse(n_cases: int, out_dir: Path, key_path: Path) -> None:
    if n_cases < 1:
        raise InputError(f"cases is {n_cases}, allowed is 1 or more")
    if out_dir.resolve() in key_path.resolve().parents:
        raise InputError("the key must not lie inside the set that it opens", where=key_path)


def _clear(waiting: list[CaseSpec], out_dir: Path) -> None:
    """Remove what a run that was broken off left of the cases to be made."""
    for spec in waiting:
        for leftover in (out_dir / spec.name, out_dir / f"{spec.name}.part"):
            shutil.rmtree(leftover, ignore_errors=True)


def _labels(waiting: list[CaseSpec], out_dir: Path, nature: Nature, workers: int) -> Any:
    """Yield name and label of every case as it is finished."""
    if workers == 1 or len(waiting) < 2:
        for spec in waiting:
            yield spec.name, _make_case(spec, out_dir, nature)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=min(workers, len(waiting)), mp_context=context) as pool:
        futures = {pool.submit(_make_case, spec, out_dir, nature): spec.name for spec in waiting}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _make_case(spec: CaseSpec, out_dir: Path, nature: Nature) -> dict[str, Any]:
    """Write one case under a temporary name, rename it, and return its label."""
    from sawbench.blindcheck.campaign import make_campaign

    part = out_dir / f"{spec.name}.part"
    parameters = "beyond" if spec.kind == "parameters" else "within"
    truth = make_campaign(spec.seed, part, effects=spec.effects, parameters=parameters, **asdict(nature))
    part.rename(out_dir / spec.name)
    return {"kind": spec.kind, "truth": truth}


def _open_key(key_path: Path, out_dir: Path, seed: int, options: dict[str, Any]) -> dict[str, Any]:
    if not key_path.exists():
        return {"schema_version": SCHEMA_VERSION, "seed": seed, "options": options, "cases": {}}
    key = read_key(key_path)
    for name, wanted in (("seed", seed), ("options", options)):
        if key[name] != wanted:
            raise InputError(
                f"was made with {name} {key[name]!r}, not {wanted!r}",
                where=key_path,
                remedy="name another --out",
            )
    missing = [name for name in key["cases"] if not (out_dir / name).is_dir()]
    for name in missing:
        del key["cases"][name]
    return key


def _seal(out_dir: Path, key_path: Path, key: dict[str, Any]) -> None:
    """Write the commitments, and their hash into the key."""
    cases = {
        name: {"commitment": commitment(entry["salt"], entry["label"]), "files": file_hashes(out_dir / name)}
        for name, entry in sorted(key["cases"].items())
    }
    write_json(out_dir / COMMITMENTS, {"schema_version": SCHEMA_VERSION, "cases": cases})
    key["commitments_sha256"] = sha256_of(out_dir / COMMITMENTS)
    write_json(key_path, key)


def commitment(salt: str, label: Mapping[str, Any]) -> str:
    """Return SHA-256(salt || canonical JSON of the label), hexadecimal.

    Examples
    --------
    >>> commitment("00", {"a": 1.0, "b": 2}) == commitment("00", {"b": 2, "a": 1.0})
    True
    """
    canonical = json.dumps(label, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(bytes.fromhex(salt) + canonical.encode()).hexdigest()


def file_hashes(case_dir: Path) -> dict[str, str]:
    """Return SHA-256 of every file of a case's campaign by name, hexadecimal; subfolders are left out."""
    return {path.name: sha256_of(path) for path in sorted(case_dir.iterdir()) if path.is_file()}


def read_key(key_path: Path) -> dict[str, Any]:
    """Read a key.

    Raises
    ------
    InputError
        If the file is missing or is no key.
    """
    key = read_json(key_path)
    if key.get("schema_version") != SCHEMA_VERSION or not isinstance(key.get("cases"), dict) or "seed" not in key:
        raise InputError("is no key of a sealed set", where=key_path, remedy="give the file that `make` named")
    return key


def verify(out_dir: Path, key_path: Path) -> dict[str, dict[str, Any]]:
    """Check that key, commitments and campaigns belong together, and return the labels by case.

    Parameters
    ----------
    out_dir, key_path : Path

    Returns
    -------
    dict of str to dict
        `kind` and `truth` (what `campaign.make_campaign` returned) by case.

    Raises
    ------
    InputError
        If a file is missing, or anything was changed after sealing; the message names all that was found.
    """
    out_dir, key_path = Path(out_dir), Path(key_path)
    key = read_key(key_path)
    open_path = out_dir / COMMITMENTS
    sealed = read_json(open_path).get("cases", {})
    found: list[str] = []
    if key.get("commitments_sha256") != sha256_of(open_path):
        found.append(f"{COMMITMENTS} is not the one that the key was made with")
    for name in sorted(set(sealed) ^ set(key["cases"])):
        found.append(f"{name} is in only one of key and commitments")
    for name in sorted(set(sealed) & set(key["cases"])):
        entry = key["cases"][name]
        if commitment(entry["salt"], entry["label"]) != sealed[name]["commitment"]:
            found.append(f"{name}: the label in the key is not the sealed one")
        if not (out_dir / name).is_dir():
            found.append(f"{name}: its folder is missing")
        else:
            now = file_hashes(out_dir / name)
            changed = [file for file, digest in sealed[name]["files"].items() if now.get(file) != digest]
            found += [f"{name}/{file} was changed or removed" for file in changed]
    if found:
        raise InputError(
            "the seal is broken:\n  " + "\n  ".join(found),
            where=out_dir,
            remedy="make the set again; do not score it",
        )
    return {name: entry["label"] for name, entry in sorted(key["cases"].items())}


def sha256_of(path: Path) -> str:
    """Return SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises
    ------
    InputError
        If the file is missing, cannot be read or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError("no such file", where=path, remedy="make the set with `sawbench blind make`") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"cannot be read: {error}", where=path) from error
    if not isinstance(content, dict):
        raise InputError("is not a JSON object", where=path)
    return content


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write through a temporary file, so that a broken-off run leaves the old or the new one."""
    write_whole(path, json.dumps(content, indent=1, sort_keys=True), overwrite=True)
