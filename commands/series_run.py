"""Leading a technician through a series: mount, clamp, tare, check, record, judge, keep or repeat."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

from sawbench.acquisition.series.journal import Journal
from sawbench.acquisition.series.plan import LoadedPlan, PlannedTrial
from sawbench.acquisition.series.progress import Part, SeriesProgress, TrialProgress, as_facts, progress_of
from sawbench.acquisition.series.rejected import free_place, move_to_rejected
from sawbench.bench.errors import InputError, SawbenchError, UntrustedResult
from sawbench.bench.recording import Trial
from sawbench.commands.series_dialogue import Dialogue

if TYPE_CHECKING:
    from sawbench.acquisition.recording_report import RecordingSummary
    from sawbench.acquisition.series.verdict import TrialMeasures
    from sawbench.bench.config import LoadedConfig

# Nobody looks on: a trial that is bad this often is a bench that is bad.
_MOST_ATTEMPTS: Final = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Bench:
    """Where a series is recorded.

    Attributes
    ----------
    loaded : LoadedConfig
    config_path, book : Path
        Bench configuration and calibration book.
    operator : str, optional
    simulated, live : bool
    """

    loaded: LoadedConfig
    config_path: Path
    book: Path
    operator: str | None = None
    simulated: bool = False
    live: bool = False

    def ports_at_rest(self, seed: int) -> AbstractContextManager[dict[str, str]]:
        """Give the ports of the instruments, simulated or configured; the simulated tool stays off."""
        from sawbench.commands.recording_session import bench_ports

        return bench_ports(self.config_path, simulated=self.simulated, seed=seed)

    def ports_of(self, trial: Trial, folder: Path, seed: int) -> AbstractContextManager[dict[str, str]]:
        """Give the ports of the instruments for a trial; see `recording_session.ports_of_trial`."""
        from sawbench.commands.recording_session import ports_of_trial

        return ports_of_trial(self.config_path, trial, folder, simulated=self.simulated, seed=seed)


class SeriesRun:
    """One sitting at a series; what was done before is found in the folder and the journal."""

    def __init__(self, plan: LoadedPlan, bench: Bench, dialogue: Dialogue) -> None:
        self._plan = plan
        self._bench = bench
        self._dialogue = dialogue
        self._journal = Journal(plan.folder)
        self._block: int | None = None
        self._attempts: dict[str, int] = {}

    def run(self) -> None:
        """Record every trial that is not kept yet.

        Raises
        ------
        SeriesStopped
            If the technician wants to go on another time.
        UntrustedResult
            If nobody looks on and the bench, or one trial three times, is bad.
        """
        self._journal.add("opened", plan_sha256=self._plan.sha256, operator=self._bench.operator)
        while (row := self._progress().next) is not None:
            try:
                self._go_on_with(row)
            finally:
                # Also where the technician stops, or the bench fails: what was noted is kept.
                for text in self._dialogue.notes:
                    self._journal.add("note", row.planned.id, text=text)
                self._dialogue.notes.clear()

    def _go_on_with(self, row: TrialProgress) -> None:
        if row.state == "to set aside":
            self._set_aside(row, because=row.rejected[-1], is_said=True)
        elif row.state == "interrupted":
            self._dialogue.say(f"\n{row.planned.id}: the recording was interrupted; the trial will be repeated")
            self._set_aside(row, because="the recording was interrupted")
        elif row.state == "undecided":
            self._dialogue.say(f"\n{row.planned.id}: already recorded, not yet kept or rejected")
            self._decide(row)
        else:
            self._trial(row)

    def _progress(self) -> SeriesProgress:
        return progress_of(self._plan, self._journal.read())

    def _row(self, planned: PlannedTrial) -> TrialProgress:
        return next(trial for trial in self._progress().trials if trial.planned.id == planned.id)

    def _trial(self, row: TrialProgress) -> None:
        planned, progress = row.planned, self._progress()
        self._dialogue.say("\n".join(["", *introduction(planned, progress)]))
        self._mount("blade", planned.blade, progress)
        self._mount("battery", planned.battery, progress)
        if planned.rest_s:
            self._rest(planned.rest_s)
        self._dialogue.ask("Enter when ready (n TEXT: note, q: stop)", default="")
        self._prepare(planned)
        try:
            summary = self._record(planned)
        except SawbenchError as error:
            self._raise_unless_worth_another(error, self._attempts.get(planned.id, 1))
            return
        row = self._row(planned)
        is_stopped = summary.is_complete and summary.duration_s < 0.95 * self._seconds(planned)
        if is_stopped and not self._dialogue.is_attended:
            self._set_aside(row, because=summary.end_reason)
            raise KeyboardInterrupt(summary.end_reason)
        self._decide(row)

    def _mount(self, part: Part, planned: str | None, progress: SeriesProgress) -> None:
        """Have the blade or battery changed that the plan, or the growth of the specific force, asks for."""
        if planned is None:
            return
        known, mounted = progress.identity(part, planned), progress.mounted(part)
        worn = progress.worn(known) if part == "blade" and known is not None else None
        if known is not None and known == mounted and worn is None:
            return
        used = progress.identities(part)
        if worn is not None:
            self._dialogue.say(f"{worn.words}: at or above +{self._plan.plan.blade_growth_limit:.0%}, change the blade")
        if known is None or worn is not None:
            number, proposed = 2, planned
            while proposed in used:
                number, proposed = number + 1, f"{planned}-{number}"
            question = (
                ("mount a new blade; its identifier") if part == "blade" else "insert a full battery; its identifier"
            )
        else:
            proposed, question = known, f"mount {part} {known} again; its identifier"
        identity = self._dialogue.ask(question, default=proposed)
        while identity in used and identity != proposed:
            self._dialogue.say(f"{part} {identity} was used before: wear and charge are tracked per identifier")
            identity = self._dialogue.ask(question, default=proposed)
        self._journal.add("mounted", part=part, planned=planned, identity=identity)
        if part == "blade":
            # Whoever changed it has touched carriage and cell.
            self._block = None

    def _rest(self, seconds: float) -> None:
        self._dialogue.say(f"the tool rests for {seconds:g} s")
        time.sleep(seconds)

    def _prepare(self, planned: PlannedTrial) -> None:
        """Zero the load cell where that is due, and look at the bench."""
        plan = self._plan.plan
        is_tare_due = plan.tare == "trial" or (plan.tare == "block" and planned.block != self._block)
        if not is_tare_due and not plan.check_seconds:
            return
        for attempt in count(1):
            try:
                with self._bench.ports_at_rest(self._seed(planned)) as ports:
                    if is_tare_due:
                        self._tare(ports)
                    if plan.check_seconds:
                        self._check(ports)
                break
            except SawbenchError as error:
                self._raise_unless_worth_another(error, attempt)
            if self._dialogue.ask("a: check again, g: continue anyway", default="a", choices="a g") == "g":
                break
        self._block = planned.block

    def _raise_unless_worth_another(self, error: SawbenchError, attempt: int) -> None:
        """Say what is wrong with the bench; raise it where another attempt changes nothing or nobody looks on."""
        if isinstance(error, InputError) or (not self._dialogue.is_attended and attempt >= _MOST_ATTEMPTS):
            raise error
        self._dialogue.say(str(error))

    def _tare(self, ports: Mapping[str, str]) -> None:
        from sawbench.commands.tare import TareRequest, describe, take_tare

        asked = TareRequest(
            book=self._bench.book, seconds=self._plan.plan.tare_seconds, operator=self._bench.operator or ""
        )
        _, resting = take_tare(self._bench.loaded, ports, asked)
        self._dialogue.say(describe(resting).splitlines()[0])

    def _check(self, ports: Mapping[str, str]) -> None:
        from sawbench.commands.check import describe, look

        found = look(self._bench.loaded, self._bench.book, ports, seconds=self._plan.plan.check_seconds)
        if not found.is_good:
            raise UntrustedResult(f"the bench is not ready to record\n{describe(found)}")
        self._dialogue.say("check: no faults")

    def _record(self, planned: PlannedTrial) -> RecordingSummary:
        from sawbench.commands.record import live_view, run_session
        from sawbench.commands.recording_session import SessionOptions

        bench, seconds, seed = self._bench, self._seconds(planned), self._seed(planned)
        options = SessionOptions(
            path=self._plan.folder / f"{planned.id}.mcap",
            trial=self._described(planned),
            seconds=seconds,
            calibration_book=bench.book,
        )
        self._attempts[planned.id] = self._attempts.get(planned.id, 0) + 1
        self._journal.add("started", planned.id)
        self._dialogue.say(f"recording {seconds:g} s; switch the tool on (Ctrl-C ends the recording)")
        with (
            live_view(options.trial, bench.loaded.config.frame, live=bench.live, rrd_path=None, force=False) as views,
            self._dialogue.meanwhile() as lines,
        ):
            summary, _ = run_session(
                bench.loaded,
                options,
                bench.ports_of(options.trial, self._plan.folder, seed),
                views,
                lines,
                self._dialogue.typed,
            )
        # They are in the recording now.
        self._dialogue.notes.clear()
        return summary

    def _described(self, planned: PlannedTrial) -> Trial:
        """Return what is written into the recording."""
        progress, bench = self._progress(), self._bench
        return Trial(
            trial_id=planned.id,
            material=planned.material,
            duty=bench.loaded.config.converter.default_duty if planned.duty is None else planned.duty,
            thickness_mm=planned.thickness_mm,
            feed_mm_s=planned.feed_mm_s,
            blade=None if planned.blade is None else progress.identity("blade", planned.blade),
            battery=None if planned.battery is None else progress.identity("battery", planned.battery),
            operator=bench.operator,
            notes="\n".join(self._dialogue.notes),
            repetition=planned.repetition,
            batch=planned.batch,
            source="simulated bench" if bench.simulated else "bench",
        )

    def _decide(self, row: TrialProgress) -> None:
        """Judge a recording and have it kept or repeated."""
        from sawbench.commands.series_verdict import describe, measured

        planned = row.planned
        self._dialogue.say("evaluating the trial …")
        self._dialogue.phase("evaluating the trial …")
        measures = measured(row.path, planned, seconds=self._seconds(planned))
        self._dialogue.phase("evaluated")
        self._journal.add("judged", planned.id, **as_facts(measures))
        row = self._row(planned)
        doubts = (*measures.faults, *row.disagrees)
        self._dialogue.say("\n".join([describe(measures), *measures.remarks, *(f"BAD: {text}" for text in doubts)]))
        question = "k: keep, r: repeat (n TEXT: note, q: stop)"
        answer = self._dialogue.ask(question, default="r" if doubts else "k", choices="k r")
        if answer == "r":
            self._set_aside(row, because="; ".join(doubts) or "repeated by the technician")
            if not self._dialogue.is_attended and self._attempts.get(planned.id, 0) >= _MOST_ATTEMPTS:
                raise UntrustedResult(
                    f"trial {planned.id} was bad {_MOST_ATTEMPTS} times: {'; '.join(doubts)}",
                    where=self._plan.folder,
                    remedy="check the bench, then continue with the same command",
                )
            return
        self._journal.add("kept", planned.id)
        self._say_what_follows(measures)

    def _say_what_follows(self, measures: TrialMeasures) -> None:
        from sawbench.acquisition.series.verdict import blade_growth

        progress = self._progress()
        growth = blade_growth(progress.kept, measures.blade) if measures.blade else None
        if growth is not None and growth.last_trial == measures.trial_id:
            self._dialogue.say(growth.words)
        for other in progress.trials:
            same = other.planned.setting == measures.setting and other.planned.id != measures.trial_id
            if same and other.state == "kept" and other.disagrees:
                self._dialogue.say(
                    f"{other.planned.id} now deviates from its repetitions: {'; '.join(other.disagrees)}\n"
                    f"  -> sawbench series repeat {self._plan.path} {other.planned.id}"
                )

    def _set_aside(self, row: TrialProgress, *, because: str, is_said: bool = False) -> None:
        second_copy = self._bench.loaded.config.recording.second_copy
        set_aside(self._journal, row, because=because, is_said=is_said, second_copy=second_copy)

    def _seconds(self, planned: PlannedTrial) -> float:
        return planned.seconds or self._plan.plan.seconds or self._bench.loaded.config.recording.seconds

    def _seed(self, planned: PlannedTrial) -> int:
        """Another piece of wood for every trial, and for every attempt at it."""
        number = [trial.id for trial in self._plan.plan.trial].index(planned.id)
        return 100_000 * (self._plan.plan.seed or 0) + 100 * number + len(self._row(planned).rejected)


def introduction(planned: PlannedTrial, progress: SeriesProgress) -> list[str]:
    """What to clamp, set and look at before a trial."""
    number = 1 + [trial.planned.id for trial in progress.trials].index(planned.id)
    repetition = "" if planned.repetition is None else f", repetition {planned.repetition}"
    lines = [f"trial {planned.id}: {number} of {len(progress.trials)}, block {planned.block}{repetition}"]
    if planned.is_idle:
        lines.append("  clamp  nothing: idle run")
    else:
        piece = [planned.material]
        piece += [] if planned.thickness_mm is None else [f"{planned.thickness_mm:g} mm"]
        piece += [] if planned.batch is None else [f"batch {planned.batch}"]
        lines.append(f"  clamp  {', '.join(piece)}")
    settings = [] if planned.duty is None else [f"duty {planned.duty:g}"]
    settings += [] if planned.feed_mm_s is None else [f"feed {planned.feed_mm_s:g} mm/s"]
    lines += [f"  set    {', '.join(settings)}"] if settings else []
    mounted = [f"{part} {name}" for part in ("blade", "battery") if (name := progress.mounted(part)) is not None]
    lines += [f"  on it  {', '.join(mounted)}"] if mounted else []
    lines.append("  look   carriage moves freely, preload is set, tool is off, hands are clear")
    return lines


def set_aside(
    journal: Journal, row: TrialProgress, *, because: str, second_copy: str | None, is_said: bool = False
) -> Path:
    """Move a recording, or what its recorder left of it, out of the way; nothing is deleted or overwritten.

    Parameters
    ----------
    journal : Journal
    row : TrialProgress
    because : str
    second_copy : str, optional
        Folder with second copies, as the configuration names it; the one of this recording is moved likewise.
    is_said : bool
        The journal has the rejection already, the file is still where it was.

    Returns
    -------
    Path
        Where it is now.
    """
    present = row.path if row.path.exists() else row.part_path
    target = free_place(present, row.planned.id)
    if not is_said:
        journal.add("rejected", row.planned.id, because=because, file=target.name)
    return move_to_rejected(present, row.planned.id, target=target, second_copy=second_copy)
