"""No private vocabulary in what a person reads: pages, templates, help, messages, docstrings."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from sawbench import PACKAGES

pytestmark = pytest.mark.contract

ROOT = Path(__file__).parents[1]
# Phrase (regular expression) -> what to say.
BANNED = {
    r"speaks? for\b|spoke for\b": "evidence for, log Bayes factor",
    r"\bwould hardly\b|\bsettles hardly\b": "detection limit; does not settle",
    r"a little of (each|every)": "nuisance parameter, background effects",
    r"nature (is |was )?made|nature again": "twin: the same campaign simulated without the effect",
    r"\blet pass\b": "maximum allowed drift",
    r"\b(stands?|standing|stood) out\b": "significant (false discovery rate 5 %)",
    r"of it scatter": "statistical part",
    r"counted in, it": "adding it explains",
    r"how hard (a|the) (piece|wood)|hardness of (the )?wood|hardness of single": "specific cutting coefficient k_Fc",
    r"this session": "nothing: pages speak of the product",
    r"\bmakes? no sense\b": "no valid frame",
    r"\b(is|stands) at its end\b": "saturated",
    r"\bkept from (it|the fit|every fit)\b": "withheld",
    r"what the model misses|what (a|the) form may miss": "residual; model discrepancy",
    r"looks? (the same|alike)|look alike": "indistinguishable, confounded",
    r"what strokes and repeats differ by": "repeatability",
    r"noise (is|was) raised|raised noise": "overdispersion",
    r"nats asked|slow to accuse|claims less": "prior odds, tempering, abstention",
    r"beside the strokes": "asynchronous with the stroke",
    r"\brubs in its guides\b|\bfan brakes\b": "guide friction, windage",
    r"\banew\b": "again",
    r"\bnot to be (trusted|relied on)\b": "not reliable",
    r"\bvouche?[sd]?\b": "verified",
    r"\bgo(es)? on (where|with|from)\b": "continue",
    r"\bright claims?\b": "correct claim",
    r"\bto and fro\b": "back and forth",
    r"\bmeasured less\b": "measured minus",
    r"\bheld against\b": "compared with",
    r"\bdealt at random\b": "assigned at random, shuffled",
    r"\b(holds|names) no\b(?! longer)": "has no, contains no",
    r"(?<!there )\bis no (MCAP|MF4|MATLAB|HDF5|JSON|CAN|DBC|UTF-8|number|archive|recording|amendment)\b": "is not a",
    r"\bcause after cause\b": "several causes, one by one",
    r"\bheld[ -]out\b": "withheld",
    r"\bbent displacement\b": "nonlinear displacement sensor",
    r"\bone (line|row|element|file|value) a (trial|stroke|recording|channel|case|material)\b": "per",
    r"\bwhat (a|an|the) \w+ is worth\b": "information, benefit",
    r"\bmodel before(?! and)\b": "model as configured",
    r"\bcut off? file still holds\b|\bthrows? (it |them )?away\b": "discard",
    r"\bnobody knows\b": "unknown",
    r"\bmakes the whole\b|\bwould have it\b": "nothing, or what is meant",
    r"\bat its own end\b|\bstands beside it\b": "is next to it",
}
TEXTS = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    ROOT / "docs" / "tutorial.ipynb",
    *(path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.j2"))),
    *(path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.toml"))),
]
MODULES = [
    path
    for name in ("api", *PACKAGES)
    for path in sorted((ROOT / name).rglob("*.py"))
    if not path.name.endswith("_pb2.py")
]


def strings(path: Path) -> str:
    """Every string of a module, docstrings too, with the whitespace of a line break taken for a space."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return "\n\n".join(n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str))


def found_in(text: str) -> list[str]:
    text = re.sub(r"[ \t]*\n[ \t]*(?=\S)", " ", text)
    return [
        f"{text[max(0, match.start() - 40) : match.end() + 40]!r}: say {instead}"
        for phrase, instead in BANNED.items()
        for match in re.finditer(phrase, text, flags=re.IGNORECASE)
    ]


def test_the_list_finds_what_it_is_made_for():
    assert found_in("places that stand\n  out") != []
    assert found_in("a standing machine, out of order") == []


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_use_the_words_of_the_field(path):
    assert found_in(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_strings_use_the_words_of_the_field(path):
    assert found_in(strings(path)) == []
