"""What the terminal shows while a trial is recorded: phase, time, OK / LOOK / STOP, channels, the note being typed."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, Any, Final

import click

if TYPE_CHECKING:
    from sawbench.acquisition.recording_report import RecordingStatus
    from sawbench.commands.live_estimate import LiveCuttingEstimate
    from sawbench.commands.typed_lines import TypedLines

_LINE_EVERY_S: Final = 5.0
LIGHTS: Final = {"ok": ("OK", "bold green"), "look": ("LOOK", "bold yellow"), "stop": ("STOP", "bold red")}


class LiveCounters:
    """Phase, samples, rates, gaps and the live k_Fc on the terminal; a plain line every few seconds where it is none.

    Parameters
    ----------
    estimate : LiveCuttingEstimate, optional
        Its trouble, if any, is said once.
    trial_id : str
    seconds : float, optional
        How long the recording is to be; None: until stopped.
    typed : TypedLines, optional
        Where notes are typed: the display then shows them, because the terminal would be drawn over.
    """

    def __init__(
        self,
        estimate: LiveCuttingEstimate | None = None,
        *,
        trial_id: str = "",
        seconds: float | None = None,
        typed: TypedLines | None = None,
    ) -> None:
        self._estimate = estimate
        self._trial_id = trial_id
        self._seconds = seconds
        self._typed = typed
        self._status: RecordingStatus | None = None
        self._is_trouble_said = False
        self._warnings: tuple[str, ...] = ()
        self._live: Any = None
        self._silence = contextlib.ExitStack()
        self._next_line_s = _LINE_EVERY_S

    def __enter__(self) -> LiveCounters:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.live import Live

            if self._typed is not None:
                self._silence.enter_context(self._typed.silent())
            self._live = Live(
                console=Console(stderr=True), get_renderable=self._drawn, refresh_per_second=8, transient=True
            )
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()
        self._silence.close()

    def __call__(self, status: RecordingStatus) -> None:
        """Show one snapshot."""
        self._status = status
        self._say_trouble()
        self._ring(status.warnings)
        if self._live is not None:
            return
        if status.phase == "finishing":
            click.echo("finishing ...", err=True)
        elif status.elapsed_s >= self._next_line_s:
            self._next_line_s += _LINE_EVERY_S
            missing = sum(channel.n_missing for channel in status.channels)
            n_samples = sum(channel.n_samples for channel in status.channels)
            estimated = "" if self._estimate is None else self._estimate.describe()
            click.echo(
                f"{status.elapsed_s:6.1f} s  {LIGHTS[status.light][0]}  {n_samples} samples  {missing} missing"
                + (f"  {estimated}" if estimated else "")
                + (f"  ({'; '.join(status.reasons)})" if status.reasons else ""),
                err=True,
            )

    def _ring(self, warnings: tuple[str, ...]) -> None:
        """Say a warning once while it lasts, with the bell of the terminal."""
        for text in warnings:
            if text not in self._warnings:
                self._say(f"WARNING {text}")
                click.echo("\a", err=True, nl=False)
        self._warnings = warnings

    def _say_trouble(self) -> None:
        problem = "" if self._estimate is None else self._estimate.problem
        if problem and not self._is_trouble_said:
            self._is_trouble_said = True
            self._say(f"no live k_Fc: {problem}")

    def _say(self, text: str) -> None:
        if self._live is not None:
            self._live.console.print(text)
        else:
            click.echo(text, err=True)

    def _drawn(self) -> Any:
        """Draw the display again; also between two snapshots, so that a note shows as it is typed."""
        from rich.console import Group
        from rich.text import Text

        parts: list[Any] = [self._headline()]
        if self._status is not None:
            parts.append(_as_table(self._status))
            if self._estimate is not None and (estimated := self._estimate.describe()):
                parts.append(Text(estimated))
        if self._typed is not None:
            parts.append(Text.assemble(("note (Enter saves it, Ctrl-C ends the recording):  ", "dim"),
                                       self._typed.pending, ("_", "blink")))  # fmt: skip
        return Group(*parts)

    def _headline(self) -> Any:
        from rich.text import Text

        status = self._status
        name = f" {self._trial_id}" if self._trial_id else ""
        if status is None:
            return Text(f"opening the instruments{name} ...", style="bold")
        if status.phase == "finishing":
            return Text(f"finishing{name} ... closing the file", style="bold")
        total = "" if self._seconds is None else f" of {self._seconds:g}"
        words, style = LIGHTS[status.light]
        why = "; ".join(status.reasons)
        return Text.assemble(
            (f"recording{name}  {status.elapsed_s:.1f}{total} s  ", "bold"), (f" {words} ", style), why
        )


def _as_table(status: RecordingStatus) -> Any:
    from rich.table import Table

    shown = Table()
    for header in ("channel", "now", "unit", "samples", "rate Hz", "gaps", "missing"):
        shown.add_column(header, justify="left" if header in {"channel", "unit"} else "right")
    for c in status.channels:
        style = "red" if c.device in status.lost_devices else "yellow" if c.n_gaps else ""
        shown.add_row(
            c.channel, "-" if c.latest is None else f"{c.latest:.3f}", c.unit, str(c.n_samples),
            f"{c.rate_hz:.1f}", str(c.n_gaps), str(c.n_missing), style=style,
        )  # fmt: skip
    return shown
