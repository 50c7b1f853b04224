"""A picture of the Rerun layout without a window."""

from __future__ import annotations

import time
from pathlib import Path

from sawbench.bench.errors import UntrustedResult
from sawbench.storage.output import write_whole
from sawbench.visualization.sdk import rr
from sawbench.visualization.viewer import ViewerProcess


def take_screenshot(
    rrd_path: str | Path,
    png_path: str | Path,
    *,
    width: int = 1600,
    height: int = 1000,
    timeout_s: float = 60.0,
) -> Path:
    """Open an `.rrd` file in a viewer without a window and save what it shows.

    Needs a Vulkan driver; a software one (Mesa's lavapipe) is enough.

    Parameters
    ----------
    rrd_path, png_path : str or Path
    width, height : int
        Size of the picture, pixels.
    timeout_s : float
        How long the viewer may take to start and to load the file, s.

    Returns
    -------
    Path
        `png_path`.

    Raises
    ------
    UntrustedResult
        If the viewer ends or is not ready in time; the message holds its last words.
    """
    viewer = ViewerProcess([str(rrd_path)], is_headless=True, window_size=(width, height))
    try:
        deadline = time.monotonic() + timeout_s
        client = _connect(viewer, deadline)
        return write_whole(png_path, _settled_picture(client, deadline), overwrite=True)
    except ConnectionError as error:  # it listens, and ends when it is to draw
        raise _without_graphics(f"the viewer broke off: {error}") from error
    finally:
        viewer.kill()


def _without_graphics(why: str) -> UntrustedResult:
    remedy = "install a Vulkan driver, on Debian `apt install mesa-vulkan-drivers`"
    return UntrustedResult(f"no screenshot: {why}", remedy=remedy)


def _connect(viewer: ViewerProcess, deadline: float) -> rr.experimental.ViewerClient:
    while time.monotonic() < deadline:
        if not viewer.is_running:
            raise _without_graphics(viewer.why_ended())
        if viewer.is_listening():
            client = rr.experimental.ViewerClient.connect(viewer.url)
            state = client.get_state()
            if state.active_recording is not None and state.views and not state.loading:
                return client
        time.sleep(0.1)
    raise UntrustedResult("no screenshot: the viewer was not ready in time")


def _settled_picture(client: rr.experimental.ViewerClient, deadline: float) -> bytes:
    """Return the first picture that equals the one before: panels fill after the file has loaded."""
    before = b""
    while time.monotonic() < deadline:
        picture = client.take_screenshot()
        if picture == before:
            return picture
        before = picture
        time.sleep(0.2)
    raise UntrustedResult("no screenshot: the picture was not complete in time")
