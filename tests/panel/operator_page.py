"""A page of the panel in a headless Chromium, used as an operator uses it: keys, text, waiting for what comes."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from tests.rigs.browser import Browser

AXE = Path(__file__).parents[1] / "reporting" / "axe.min.js"
PATIENCE_S = 120.0
ALT = 1


class OperatorPage(Browser):
    """What the whole visit complained about and asked for is in `all_complaints` and `all_requests`."""

    def __init__(self, profile: Path):
        self._before: tuple[list[str], list[str]] = ([], [])
        super().__init__(profile)

    @property
    def all_complaints(self) -> list[str]:
        self.run("0")
        return self._before[0] + self.complaints

    @property
    def all_requests(self) -> list[str]:
        self.run("0")
        return self._before[1] + self.requests

    def open(self, page, **how) -> None:
        """Load a page; what the former ones said is kept."""
        self._before = (self._before[0] + self.complaints, self._before[1] + self.requests)
        super().open(page, **how)

    def wait_for(self, condition: str, *, seconds: float = PATIENCE_S) -> None:
        """Wait until a condition holds in the page; a page that is being left has none."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            with contextlib.suppress(AssertionError):
                if self.run(f"Boolean({condition})"):
                    return
            time.sleep(0.1)
        raise TimeoutError(f"{condition}\n{self.run('document.body.innerText')}")

    def press(self, key: str, *, code: int, text: str = "", modifiers: int = 0) -> None:
        """Press and release a key."""
        facts = {"key": key, "windowsVirtualKeyCode": code, "modifiers": modifiers}
        # An access key is known by the text that it would give without Alt.
        text = text or (key if len(key) == 1 else "")
        self.ask("Input.dispatchKeyEvent", type="keyDown", text=text, unmodifiedText=text, **facts)
        self.ask("Input.dispatchKeyEvent", type="keyUp", **facts)

    def access_key(self, letter: str) -> None:
        """Press an access key."""
        self.press(letter, code=ord(letter.upper()), modifiers=ALT)

    def type(self, text: str) -> None:
        """Type a text where the focus is."""
        self.ask("Input.insertText", text=text)

    def size(self, width: int, height: int = 900) -> None:
        """Give the window a size."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def axe(self) -> list[str]:
        """What axe finds serious or worse on the page."""
        self.run(AXE.read_text(encoding="utf-8") + ";0")
        return self.run(
            "axe.run(document, {resultTypes: ['violations']}).then(found => found.violations"
            ".filter(one => ['serious', 'critical'].includes(one.impact))"
            ".map(one => one.id + ': ' + one.nodes.map(node => node.html.slice(0, 120)).join(' | ')))"
        )
