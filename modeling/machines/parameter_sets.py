"""Parameter sets: complete configurations that come with the package, a source beside every number."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sawbench.bench.config import BenchConfig, parse_config
from sawbench.bench.errors import InputError

_FOLDER = Path(__file__).parent


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterSet:
    """One configuration of the package.

    Attributes
    ----------
    name : str
    about : str
        The first sentence of its file.
    text : str
        TOML, as a bench_config.toml.
    config : BenchConfig
    """

    name: str
    about: str
    text: str
    config: BenchConfig


def names() -> tuple[str, ...]:
    """Names of all parameter sets.

    Examples
    --------
    >>> names()
    ('linear_axis', 'paper_jigsaw', 'slider_crank_saw')
    """
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def parameter_set(name: str) -> ParameterSet:
    """Read one parameter set.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in names():
        raise InputError(f"there is no machine {name!r}", remedy=f"one of {', '.join(names())}")
    text = (_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    comment = " ".join(line.removeprefix("# ") for line in text.partition("\n\n")[0].splitlines())
    return ParameterSet(name=name, about=comment.partition(". ")[0] + ".", text=text, config=parse_config(text).config)
