"""What the commands say, in words for the panel: its boxes and buttons for options and keys, local time for UTC."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Final

# Text of a command -> what the panel shows; lines that only a terminal needs are dropped.
_REPLACED: Final[tuple[tuple[re.Pattern[str], str], ...]] = tuple(
    (re.compile(pattern, re.MULTILINE), words)
    for pattern, words in (
        (r" \(Ctrl-C(?: ends(?: the recording)?)?\)", ""),
        (r"^Enter when ready:.*(?:\n|$)", ""),
        (r"^k: keep, r: repeat: k$", "Answer: keep"),
        (r"^k: keep, r: repeat: r$", "Answer: repeat"),
        (r"^a: check again, g: continue anyway: a$", "Answer: check again"),
        (r"^a: check again, g: continue anyway: g$", "Answer: continue anyway"),
        (r"\bpress Enter\b", "press Answer"),
        (r"`sawbench amend [^`]* --duty ([\d.]+)`", r"correct the duty to \1 on the page of the recording"),
    )
)
_UTC: Final = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d)(?::\d\d(?:\.\d+)?)?(?:\+00:00|Z| UTC)(?!\w)"
)  # fmt: skip
_OF_OPTION: Final = re.compile(
    r"(?:Invalid value for|Missing option) '(?:-\w, )*--([\w-]+)'(?: / .*?)?[:.] ?(.*)", re.DOTALL
)
_KINDS: Final = (("is not a valid float range", "is not a number"), ("is not a valid float", "is not a number"),
                 ("is not a valid integer range", "is not a whole number"),
                 ("is not a valid integer", "is not a whole number"))  # fmt: skip


def local(moment: datetime) -> str:
    """Write a moment as every page of the panel does: date and local time.

    Parameters
    ----------
    moment : datetime
        Timezone-aware.
    """
    return moment.astimezone().strftime("%Y-%m-%d %H:%M")


def in_panel(text: str) -> str:
    r"""Turn what a command said, whole lines of it, into words for the panel.

    Examples
    --------
    >>> in_panel("Enter when ready: \nrecording 4 s; switch the tool on (Ctrl-C ends the recording)\n")
    'recording 4 s; switch the tool on\n'
    >>> in_panel("k: keep, r: repeat: k")
    'Answer: keep'
    """
    for pattern, words in _REPLACED:
        text = pattern.sub(words, text)
    return _UTC.sub(lambda found: local(datetime.fromisoformat(f"{found[1]}T{found[2]}+00:00")), text)


def refusal_in_panel(text: str, labels: Mapping[str, str]) -> str:
    """Name the field of a form instead of the option that a command refuses.

    Parameters
    ----------
    text : str
        As the command says it.
    labels : mapping of str to str
        Option, without its dashes, to the label of its field.

    Examples
    --------
    >>> refusal_in_panel("Invalid value for '--duty': 'x' is not a valid float range.", {"duty": "Duty"})
    "Duty: 'x' is not a number."
    """
    found = _OF_OPTION.fullmatch(text)
    if found is None:
        return in_panel(text)
    label = labels.get(found[1], found[1].replace("-", " ").capitalize())
    said = found[2] or "a value is required"
    for was, now in _KINDS:
        said = said.replace(was, now)
    return f"{label}: {in_panel(said)}"
