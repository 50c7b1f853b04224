"""Entry point of `sawbench`: finds the subcommand, turns errors into one message and an exit code."""

from __future__ import annotations

import gc
import importlib
import json
import os
import signal
import sys
from types import MappingProxyType
from typing import Final, Never

import click
from sawbench.bench.errors import SawbenchError

# name -> (module with an attribute `command`, one line for the overview). Listed here, so that the overview
# needs none of the modules.
SUBCOMMANDS: Final = MappingProxyType(
    {
        "demo": "run the complete workflow on the simulated bench, from instruments to report",
        "init": "write a bench configuration: find ports, ask for the rest, store serial numbers",
        "check": "check the instruments: live values, rates, noise, missing samples, faults",
        "tare": "zero the load cell",
        "calibrate": "multi-point calibration of a channel, with its uncertainty",
        "record": "record one trial to MCAP",
        "series": "plan a series of trials, record it step by step, continue it after a break",
        "import": "import campaign.toml, tables of other programs or a CAN log into MCAP",
        "info": "show the content of recordings: one in detail, several as a table",
        "amend": "correct wrong settings; the recording itself is not changed",
        "recover": "recover the data of a truncated or damaged recording",
        "export": "export every sample to CSV, Parquet or MF4",
        "process": "find the stroke period, fold the channels, check their quality",
        "fit": "fit the specific cutting coefficient k_Fc with its uncertainty",
        "runtime": "predict the battery runtime with its uncertainty",
        "battery": "fit a battery model to measured discharges, with its uncertainty and range",
        "machines": "list the parameter sets of the package",
        "simulate": "run the electromechanical model alone",
        "report": "write the report page of a trial: signals, stroke, fit, model, battery runtime",
        "compare": "compare materials: report page, CSV, HDF5",
        "catalogue": "list the content of an archive: material, blade, battery, operator, period, k_Fc, quality",
        "watch": "process new recordings in a folder and keep the comparison page up to date",
        "diagnose": "diagnose the sim-to-real gap: location, cause, magnitude",
        "blind": "test the diagnosis on hidden effects: make, answer, score",
        "panel": "operate the bench in a browser, from tare to diagnosis",
        "view": "replay a recording in Rerun",
        "simbench": "run simulated instruments for other programs",
    }
)
# What is imported stays: with Python's own 700 looking through it again and again took a tenth of a short command.
_OBJECTS_BETWEEN_COLLECTIONS: Final = 50_000
_MODULE_OF: Final = MappingProxyType({"import": "import_"})


class LazyGroup(click.Group):
    """Import a subcommand only when it is called, so that `--help` stays fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the work."""
        del ctx
        return list(SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return one subcommand."""
        del ctx
        if cmd_name not in SUBCOMMANDS:
            return None
        module = importlib.import_module(f"sawbench.commands.{_MODULE_OF.get(cmd_name, cmd_name)}")
        return module.command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the overview from the table, without importing anything."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(SUBCOMMANDS.items()))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Example: sawbench demo --out demo --seconds 8",
)
@click.version_option(package_name="sawbench", prog_name="sawbench")
def cli() -> None:
    """Record, process, model and compare jigsaw cutting trials."""


def main(arguments: list[str] | None = None) -> int:
    """Run `sawbench` and return its exit code: 0 done, 2 wrong input, 1 ran but not reliable.

    Parameters
    ----------
    arguments : list of str, optional
        Instead of `sys.argv[1:]`.
    """
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS, 10, 10)
    as_json = "--json" in (sys.argv[1:] if arguments is None else arguments)
    try:
        code = cli.main(args=arguments, prog_name="sawbench", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except SawbenchError as error:
        _say_as_json(as_json, error.exit_code, what=error.what, where=error.where, remedy=error.remedy)
        return _fail(f"error: {error}", error.exit_code)
    except click.ClickException as error:
        _say_as_json(as_json, error.exit_code, what=error.format_message())
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, click.exceptions.Abort) as error:
        # click turns an interruption into an Abort without its words.
        message = str(error) or str(error.__cause__ or "") or "interrupted"
        _say_as_json(as_json, 130, what=message)
        return _fail(message, 130)
    except BrokenPipeError:
        # The reader of our output (head, less) has gone: nothing to say and nobody to say it to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get("SAWBENCH_DEBUG"):
            raise
        message = _unexpected(error)
        _say_as_json(as_json, 1, what=message.removeprefix("error: "))
        return _fail(message, 1)


def _unexpected(error: Exception) -> str:
    """Say what no command has foreseen: a disk or folder that refuses, or a mistake of ours."""
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return f"error: {place}cannot be read or written: {error.strerror or error}"
    return (
        f"internal error, please report it: {type(error).__name__}: {error}\n"
        "  -> run again with SAWBENCH_DEBUG=1 for the traceback"
    )


def _say_as_json(
    as_json: bool, exit_code: int, *, what: str, where: str | None = None, remedy: str | None = None
) -> None:
    """Print an error for a program, beside the message for people (docs/json_output.md)."""
    if as_json:
        error = {"what": what, "where": where, "remedy": remedy, "exit_code": exit_code}
        click.echo(json.dumps({"error": error}, indent=2))


def _fail(message: str, code: int) -> int:
    click.echo(f"sawbench: {message}", err=True)
    return code


def run() -> None:
    """Console-script entry: exit with the code of `main`."""
    signal.signal(signal.SIGTERM, raise_terminated)
    # `nohup` has it ignored; Windows has none.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, raise_hung_up)
    code = main()
    gc.freeze()  # else all that a long command has made is looked through once more, for half a second
    sys.exit(code)


def raise_terminated(*_: object) -> Never:
    """End on SIGTERM as on Ctrl-C: a recording is finished, the simulated instruments are stopped."""
    raise KeyboardInterrupt("stopped by another process (SIGTERM)")


def raise_hung_up(*_: object) -> Never:
    """End as on Ctrl-C where the window of the terminal was closed, or the connection to it broke."""
    # The shell says so too, and a second interruption would cut short the end of a recording.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    raise KeyboardInterrupt("the terminal was closed (SIGHUP)")


if __name__ == "__main__":
    run()
