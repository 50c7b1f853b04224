"""Options that several subcommands share."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import click
from sawbench.bench.errors import InputError
from sawbench.inputs import shipped_config
from sawbench.storage.places import Place, StoreFile, find_file, place_of

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

_USUAL: Final = "./bench_config.toml, else that of the package"


def config_option_of(default: str) -> Decorator:
    """Add `--config`; `default` says which configuration holds without it."""
    kind = click.Path(path_type=Path, dir_okay=False)
    return click.option("--config", "config_path", type=kind, help=f"Bench configuration; default: {default}.")


config_option: Decorator = config_option_of(f"that of the recording, else {_USUAL}")
bench_config_option: Decorator = config_option_of(_USUAL)  # of commands that read no recording
plan_config_option: Decorator = config_option_of(f"that of the plan, else {_USUAL}")


class PlaceType(click.Path):
    """A path, or the URL of a file or folder in an object store."""

    name = "place"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return a `Path` or a `StoreFile`."""
        found = place_of(value)
        return super().convert(found, param, ctx) if isinstance(found, Path) else found


class NumberType(click.FloatRange):
    """A number, with a decimal point or comma as in the panel."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return a float."""
        has_comma = isinstance(value, str) and value.count(",") == 1 and "." not in value
        return super().convert(value.replace(",", ".") if has_comma else value, param, ctx)


PLACE: Final = PlaceType(path_type=Path)
json_option: Decorator = click.option("--json", "as_json", is_flag=True, help="Print machine-readable JSON.")
force_option: Decorator = click.option("--force", is_flag=True, help="Overwrite files that exist.")
places_argument: Decorator = click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=PLACE)
recordings_argument: Decorator = click.argument(
    "paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)


def setting_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the settings of a trial that somebody has to state."""
    options = (
        click.option("--duty", type=NumberType(0, 1, min_open=True), help="Commanded PWM duty, 0..1."),
        click.option("--thickness", "thickness_mm", type=NumberType(0, min_open=True), help="mm"),
        click.option("--feed", "feed_mm_s", type=NumberType(0), help="mm/s"),
        click.option("--blade", help="Blade identifier; its wear carries over to later trials."),
        click.option("--battery", help="Battery identifier; its state of charge carries over to later trials."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def calibration_book_path(config_path: Path, *, simulated: bool) -> Path:
    """Place of the tares and calibrations that belong to a configuration."""
    from sawbench.acquisition.calibration_book import book_path

    return book_path(config_path, simulated=simulated, shipped=shipped_config())


def refuse_unwritable(path: Place, *, force: bool, makes_folder: bool = False) -> None:
    """Raise, before any work is done, if a result cannot be written to `path`.

    Parameters
    ----------
    path : Path
    force : bool
        Whether a file that exists may be replaced.
    makes_folder : bool
        Whether the command makes the folder where it is missing.

    Raises
    ------
    InputError
    """
    if find_file(path) is not None and not force:
        raise InputError("already exists", where=path, remedy="give another file name, or overwrite with --force")
    if isinstance(path, StoreFile):
        return
    if not makes_folder and not path.parent.exists():
        raise InputError("the folder does not exist", where=path, remedy=f"create {path.parent} first")
    is_device = path.exists() and not path.is_file()
    if not is_device:
        refuse_unwritable_folder(path.parent)


def refuse_same_result(results: Mapping[Place, Place]) -> None:
    """Raise, before any work is done, if the results of two files would have one name.

    Parameters
    ----------
    results : mapping of Path or StoreFile to Path or StoreFile
        File to what is made of it.

    Raises
    ------
    InputError
        Names both files and the result.
    """
    first: dict[Place, Place] = {}
    for path, result in results.items():
        if first.setdefault(result, path) != path:
            raise InputError(
                f"would be made of two recordings, {first[result]} and {path}",
                where=result,
                remedy="give the recordings one by one, each with a folder of its own (--out)",
            )


def refuse_unwritable_folder(folder: Path) -> None:
    """Raise, before any work is done, if no file can be made in `folder`, or where the folder would be made.

    Raises
    ------
    InputError
    """
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise InputError(
            f"cannot be written to: {error.strerror or error}",
            where=folder,
            remedy="give another folder, or allow writing there",
        ) from error
