"""What pages call the motion of a machine and its channels: strokes of a blade, or cycles of an axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from sawbench.bench.processed import Frame, TrialStatus
from sawbench.bench.units import CHANNEL_BY_NAME


@dataclass(frozen=True, kw_only=True, slots=True)
class MachineWords:
    """Words of a machine, in lower case and singular; statuses are sentences without their full stop.

    Attributes
    ----------
    cycle, rate : str
        A period of the motion, and how many of them a second has.
    folded : str
        How several of them are drawn as one.
    angle, angles, zero : str
        The phase within a cycle, several of them, and where it is 0°.
    load : str
        What the machine works on.
    idle : str
        A trial without it.
    not_running : mapping of str to str
        What a phase is called in which the machine does not run steadily; by `Phase.kind`.
    labels : mapping of str to str
        Of channels that the machine has other words for than `bench.units`.
    settings : tuple of str
        Settings of a trial that a page lists also where nobody stated them.
    statuses : mapping of str to str
        What a trial showed, by `ProcessedTrial.status`.
    """

    cycle: str
    rate: str
    folded: str
    angle: str
    angles: str
    zero: str
    load: str
    idle: str
    not_running: Mapping[str, str]
    labels: Mapping[str, str]
    settings: tuple[str, ...]
    statuses: Mapping[TrialStatus, str]

    @property
    def period(self) -> str:
        """How long a cycle takes."""
        return f"{self.cycle} period"

    def label(self, channel: str) -> str:
        """Words of a channel; the name of one that nobody described.

        Examples
        --------
        >>> SAW.label("displacement_mm"), AXIS.label("displacement_mm"), AXIS.label("drive_force_n")
        ('blade displacement', 'displacement', 'drive_force_n')
        """
        known = CHANNEL_BY_NAME.get(channel)
        return self.labels.get(channel, channel if known is None else known.label)

    def told(self, text: str) -> str:
        """Say in these words what was said of the strokes of a saw.

        Examples
        --------
        >>> AXIS.told("only 2 complete strokes over the crank angle")
        'only 2 complete cycles over the phase of the cycle'
        """
        return text.replace(SAW.cycle, self.cycle).replace(SAW.angle, self.angle)


SAW: Final = MachineWords(
    cycle="stroke",
    rate="stroke rate",
    folded="over one turn of the crank",
    angle="crank angle",
    angles="crank angles",
    zero="0° is the dead centre with the blade retracted",
    load="material",
    idle="blade in air",
    not_running={
        "rest": "rest",
        "spin_up": "spin-up",
        "in_air": "in air",
        "spin_down": "spin-down",
        "stall": "stall",
    },
    labels={},
    settings=("thickness", "duty", "feed", "repetition", "blade", "battery"),
    statuses={
        "cutting": "The saw cut",
        "no_cutting": "The blade ran without cutting",
        "stalled": "The saw stalled",
        "no_stroke": "No stroke was found",
    },
)
_LEFT_OUT: Final = "not used for the period"
AXIS: Final = MachineWords(
    cycle="cycle",
    rate="cycle rate",
    folded="averaged",
    angle="phase of the cycle",
    angles="phases of the cycle",
    zero="0° is the end of the travel with the smallest displacement",
    load="load",
    idle="no load",
    not_running=dict.fromkeys(("rest", "spin_up", "spin_down", "stall"), _LEFT_OUT),
    labels={"displacement_mm": "displacement", "force_n": "force"},
    settings=("repetition",),
    statuses={
        "moving": "The axis moved back and forth",
        "stalled": "The axis stood still",
        "no_stroke": "No motion back and forth at a constant rate was found",
    },
)
_WORDS: Final[Mapping[Frame, MachineWords]] = {"crank": SAW, "linear_axis": AXIS}


def words_of(frame: Frame) -> MachineWords:
    """Words of the machines of a frame (`Machine.frame`)."""
    return _WORDS[frame]
