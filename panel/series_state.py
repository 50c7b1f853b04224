"""Plans of series that lie in a folder, and how far each is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sawbench.acquisition.series.journal import Journal
from sawbench.acquisition.series.plan import LoadedPlan, is_plan, load_plan
from sawbench.acquisition.series.progress import SeriesProgress, progress_of
from sawbench.bench.errors import SawbenchError


@dataclass(frozen=True, kw_only=True, slots=True)
class SeriesState:
    """One plan.

    Attributes
    ----------
    path : Path
    plan : LoadedPlan or None
    progress : SeriesProgress or None
    problem : str
        Why there is no progress.
    """

    path: Path
    plan: LoadedPlan | None = None
    progress: SeriesProgress | None = None
    problem: str = ""

    @property
    def name(self) -> str:
        """Name of the plan."""
        return self.path.stem

    @property
    def key(self) -> str:
        """By what a page names it."""
        return key_of(self.path)

    @property
    def n_kept(self) -> int:
        """How many trials are kept."""
        return 0 if self.progress is None else sum(row.state == "kept" for row in self.progress.trials)


def key_of(path: Path) -> str:
    """Name of the file; a plan that a diagnosis has written has the name of its job before it."""
    return f"{path.parent.parent.name}-{path.name}" if path.parent.name == "gap" else path.name


def known_plans(folders: Iterable[Path]) -> dict[str, Path]:
    """Return the plans of folders, by key; what is no plan (`is_plan`) is passed over.

    Parameters
    ----------
    folders : iterable of Path
    """
    found = [path for folder in folders for ending in ("*.toml", "*.csv") for path in sorted(folder.glob(ending))]
    return {key_of(path): path for path in found if is_plan(path)}


def series_state(path: Path) -> SeriesState:
    """Read a plan and derive how far it is; what is wrong is said in `problem`."""
    plan = None
    try:
        plan = load_plan(path)
        return SeriesState(path=path, plan=plan, progress=progress_of(plan, Journal(plan.folder).read()))
    except SawbenchError as error:
        return SeriesState(path=path, plan=plan, problem=str(error))
