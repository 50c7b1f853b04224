"""The page `docs/peers.md`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sawbench.blindcheck.scoring import Score

from benchmarks.diagnosis_peers.table import table
from benchmarks.diagnosis_peers.training import PEERS

_TOP = """# Peers: other ways to name the effect

The same campaigns, reduced by the same code, with the same hypotheses (29 effects, their pairs, "no gap",
"parameters", "unknown"), scored by `blindcheck.scoring`. What each peer is and how to run it stands at the end.

"""
_ISOLABILITY = """
## Isolability: by structure, and by the signatures of a campaign
Structural: the number of effects that faultdiagnosistoolbox cannot tell from this one, from the incidence of variables
and equations alone. Computed: signatures whose cosine is above 0.95 in some form once parameters are re-tuned;
Kullback-Leibler numbers at the typical size against no effect, and against the nearest other effect at any size (nats).

| effect | structurally inseparable from | signatures alike | against nothing | against the nearest |
|---|---|---|---|---|
"""
_END = """
## What the peers are
- plain BIC: least squares with white sensor noise (from second differences) and raw sample counts, chi^2 + k ln n; the
  best form of every effect. Four choices by log-loss: k_Fc for each trial or stock, whether "no gap" may move
  parameters within their uncertainty, whether low harmonics compete as "unknown", whether pairs compete.
- random forest (scikit-learn): some 1800 residual features after re-tuning: harmonics of every equation by class of
  operating point, start-up, drift, scatter, parameters, misfits. Leaf size, features per split and sharpening are
  chosen out of bag.
- pysindy terms: sequentially thresholded least squares of the residuals on parameters, best forms of the effects and
  nameless harmonics; 20 bootstraps, each a vote. Threshold, ridge, least shares and prior votes by log-loss.
- BayesFlow classifier: `ModelComparisonApproximator` (JAX) on 64 principal components of the forest's features, five
  networks, tempered on the cases that each has not seen.
- A peer's group: effects at most 5 times less probable than the one it declares. Pairs of the two classifiers: the
  probability of the class "pair", dealt to pairs in proportion to their effects' probabilities.
- Time: reading and reducing the campaign included, on one thread; of the diagnosis, the last step of `blind answer`.

## How to run it
```
python -m benchmarks.diagnosis_peers develop --seed 21 --cases 600 --out peers/dev
python -m benchmarks.diagnosis_peers train peers/dev --models peers/models
python -m benchmarks.diagnosis_peers features blind/set
python -m benchmarks.diagnosis_peers answer blind/set --models peers/models
python -m benchmarks.diagnosis_peers isolability blind/set --cases 3
python -m benchmarks.diagnosis_peers score blind/set --key blind/set.key.json --out docs/peers.md
```
Needs the extra `peers` (`pip install -e .[peers]`). `develop` makes campaigns as `blind make` does, keeps their
features and discards them; it takes seeds 1 to 999 only. `develop` and `features` continue where they were broken off,
and `--first K --every N` shares them among N processes. Only `score` is given the key. Features and answers lie beside
the set, in `<set>.peers/`.
"""


def page(scores: Mapping[str, Score], about: Mapping[str, Any], isolability: Sequence[Sequence[str]] | None) -> str:
    """Markdown of the page.

    Parameters
    ----------
    scores : mapping of str to Score
    about : mapping
        Of `table.score_set`.
    isolability : sequence of rows, optional
        Of `isolability.isolability_rows`.
    """
    claim = "a seed for tuning, no claim" if about["seed"] < 1000 else "outside of the tuning seeds"
    dirty = " with changes" if about["is_dirty"] else ""
    part = f" (the first by name of {about['n_in_set']})" if about["n_cases"] < about["n_in_set"] else ""
    lines = [
        f"{about['n_cases']} cases{part}, seed {about['seed']} ({claim}), {about['options']};",
        f"sawbench {about['version']}, commit {about['commit']}{dirty}; {about['date']}.",
        "In brackets 95 % intervals; the best of a row is bold.",
        "",
    ]
    for title, record in about["training"].items():
        lines.append(
            f"- {title}: {record['n_cases']} development cases, log-loss there {record['log_loss']:.2f};"
            f" {record['settings']}"
        )
    silent = [title for title in PEERS.values() if title not in scores]
    if silent:
        lines.append(f"- No answers, so not in the table: {', '.join(silent)}.")
    text = _TOP + "\n".join(lines) + "\n\n" + table(scores)
    if isolability:
        text += _ISOLABILITY
        text += "".join("| " + " | ".join([f"`{row[0]}`", *row[1:]]) + " |\n" for row in isolability)
    return text + _END
