"""Pages of results as the panel shows them: with a way back, and links that lead to pages of the panel."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape


def with_way_back(page: str, *, job: str, title: str, links: Mapping[str, str]) -> str:
    """Return the page of a result with a link to its job before it; it lies elsewhere than the panel shows it.

    Parameters
    ----------
    page : str
        HTML, as the command wrote it.
    job, title : str
        Identifier and title of the job.
    links : mapping of str to str
        Links of the page to replace: as written -> address in the panel; empty: what it names is not there any more.
    """
    for written, address in links.items():
        anchor = re.compile(rf'<a href="{re.escape(escape(written))}">(.*?)</a>', re.DOTALL)
        shown = rf'<a href="{escape(address)}">\1</a>' if address else r"\1"
        page = anchor.sub(shown, page)
    # Of the class that the pages leave out on paper.
    back = f'<p class="by-hand">sawbench panel: <a href="/jobs/{escape(job)}">{escape(title)}</a></p>'
    return page.replace("<body>", f"<body>\n{back}", 1)
