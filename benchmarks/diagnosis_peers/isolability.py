"""Which effects can be told apart: by structure (faultdiagnosistoolbox), and by the signatures of a campaign.

By structure only: which variables stand in which equation, and in which equation an effect enters. Two effects in one
equation can then never be told apart, whatever their form. By signatures: the angle between what two effects do to the
whitened residuals once all parameters are re-tuned, and the Kullback-Leibler number of Eriksson, Frisk and Krysander,
Automatica 49, 1591 (2013): half the squared length of what remains of one signature after the other effect was
fitted to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, catalogue_columns
from sawbench.diagnosis.inference.linear_problem import LinearProblem

from benchmarks.diagnosis_peers.hypotheses import EFFECTS

# Equations of the jigsaw: variables, and the effects that add a term to them.
_UNKNOWN = ("i", "di", "w", "dw", "phi", "dphi", "force", "vb", "ib", "q", "dq", "flux")
_KNOWN = ("duty", "y_x", "y_i", "y_force", "y_vb", "y_ib")
EQUATIONS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "armature": (
        ("i", "di", "w", "flux", "vb", "duty"),
        ("winding_heating", "brush_voltage_drop", "converter_diode_drop", "current_limit"),
    ),
    "shaft": (
        ("i", "flux", "w", "dw", "phi", "force"),
        ("guide_friction", "motor_coulomb_friction", "windage_drag", "load_dependent_friction", "yoke_backlash",
         "gear_eccentricity"),
    ),
    "cutting law": (
        ("force", "w", "phi"),
        ("blade_compliance", "return_stroke_rubbing", "tooth_passing_ripple", "cutting_speed_exponent", "edge_force",
         "chip_thickness", "blade_wear", "grain_variation", "engagement_delay"),
    ),
    "magnets": (("flux",), ("magnet_weakening",)),
    "battery": (("vb", "ib", "q"), ("battery_internal_resistance", "battery_polarization")),
    "converter": (("ib", "i", "duty"), ("converter_loss",)),
    "charge": (("dq", "ib"), ()),
    "crank": (("dphi", "w"), ()),
    "displacement": (("y_x", "phi"), ()),
    "current reading": (("y_i", "i"), ("current_sensor_lag",)),
    "force reading": (
        ("y_force", "force"),
        ("carriage_resonance", "preload_lift_off", "force_sensor_lag", "force_offset_drift", "clock_offset"),
    ),
    "voltage reading": (("y_vb", "vb"), ()),
    "battery current reading": (("y_ib", "ib"), ()),
}  # fmt: skip
_RATES = (("di", "i"), ("dw", "w"), ("dphi", "phi"), ("dq", "q"))
# Signatures at a smaller angle than this count as one.
SAME_COSINE = 0.95


@dataclass(frozen=True, kw_only=True, slots=True)
class Isolability:
    """How well the effects can be told apart in a campaign.

    Attributes
    ----------
    cosine : ndarray, shape (n, n)
        Largest cosine between forms of two effects, after all parameters are re-tuned, in the order of `EFFECTS`.
        NaN where the campaign shows nothing of one.
    distance : ndarray, shape (n, n)
        Kullback-Leibler number of effect i at its typical size against effect j at any, nats: what the data says at
        least, on average, for i against j. On the diagonal against no effect at all.
    """

    cosine: Floats
    distance: Floats


def structural_isolability() -> tuple[tuple[str, ...], np.ndarray]:
    """Analyse the structure of the jigsaw's equations.

    Returns
    -------
    undetectable : tuple of str
    is_isolable : ndarray of bool, shape (n, n)
        Whether effect i can be told from effect j, in the order of `EFFECTS`.
    """
    import faultdiagnosistoolbox as fdt

    relations: list[Any] = [[*variables, *effects] for variables, effects in EQUATIONS.values()]
    relations += [fdt.DiffConstraint(rate, of) for rate, of in _RATES]
    model = fdt.DiagnosisModel(
        {"type": "VarStruc", "x": list(_UNKNOWN), "f": list(EFFECTS), "z": list(_KNOWN), "rels": relations},
        name="jigsaw",
    )
    _, undetectable = model.DetectabilityAnalysis()
    # The toolbox marks with 1 what can not be isolated.
    return tuple(map(str, undetectable)), np.asarray(model.IsolabilityAnalysis()) == 0


def computed_isolability(problem: LinearProblem, columns: dict[str, list[Column]] | None = None) -> Isolability:
    """Compare the signatures of all effects in one campaign.

    Parameters
    ----------
    problem : LinearProblem
    columns : dict of str to list of Column, optional
        Of `catalogue_columns`.

    Returns
    -------
    Isolability
    """
    columns = catalogue_columns(problem, problem.campaign.plant.effects) if columns is None else columns
    projected = {name: _projected(problem, columns.get(name, [])) for name in EFFECTS}
    n = len(EFFECTS)
    cosine, distance = np.full((n, n), np.nan), np.full((n, n), np.nan)
    for i, first in enumerate(EFFECTS):
        if not projected[first]:
            continue
        own = projected[first][len(projected[first]) // 2][:, :1]
        energy = float(np.sum(own**2))
        distance[i, i], cosine[i, i] = 0.5 * energy, 1.0
        for j, second in enumerate(EFFECTS):
            if i == j or not projected[second]:
                continue
            bases = [_basis(shape) for shape in projected[second]]
            distance[i, j] = 0.5 * (energy - max(_captured(own, basis) for basis in bases))
            if j > i:
                mine = [_basis(shape) for shape in projected[first]]
                cosine[i, j] = cosine[j, i] = _largest_cosine(mine, bases)
    return Isolability(cosine=cosine, distance=distance)


def _projected(problem: LinearProblem, shapes: Sequence[Column]) -> list[Floats]:
    """Signatures under M^-1/2: what re-tuning within the priors can imitate counts for little."""
    vectors, values, _ = np.linalg.svd(problem.nuisance, full_matrices=False)
    weight = 1.0 - 1.0 / np.sqrt(1.0 + values**2)
    found = [shape.columns - vectors @ (weight[:, None] * (vectors.T @ shape.columns)) for shape in shapes]
    return [columns for columns in found if np.linalg.norm(columns) > 0]


def _basis(columns: Floats) -> Floats:
    """Orthonormal columns; a single one keeps its sign."""
    return columns / np.linalg.norm(columns) if columns.shape[1] == 1 else np.linalg.qr(columns)[0]


def _captured(own: Floats, basis: Floats) -> float:
    """Energy of a signature that another effect can take; one of a fixed sign only where they point the same way."""
    part = basis.T @ own
    if basis.shape[1] == 1:
        part = np.maximum(part, 0.0)
    return float(np.sum(part**2))


def _largest_cosine(first: list[Floats], second: list[Floats]) -> float:
    if first[0].shape[1] == 1 and second[0].shape[1] == 1:
        return float(np.max(np.hstack(first).T @ np.hstack(second)))
    return max(float(np.linalg.svd(a.T @ b, compute_uv=False)[0]) for a in first for b in second)


def isolability_rows(
    structural: tuple[tuple[str, ...], np.ndarray], found: Sequence[Isolability]
) -> list[tuple[str, str, str, str, str]]:
    """Lines of the page: effect, what structure and signatures cannot tell it from, length and nearest neighbour.

    Parameters
    ----------
    structural : tuple
        Of `structural_isolability`.
    found : sequence of Isolability
        Of some campaigns; medians are taken.
    """
    _, is_isolable = structural
    cosine = np.nanmedian([item.cosine for item in found], axis=0)
    distance = np.nanmedian([item.distance for item in found], axis=0)
    rows = []
    for i, name in enumerate(EFFECTS):
        others = [j for j in range(len(EFFECTS)) if j != i]
        alike = [EFFECTS[j] for j in others if cosine[i, j] > SAME_COSINE]
        same = [EFFECTS[j] for j in others if not is_isolable[i, j]]
        nearest = min(others, key=lambda j, i=i: np.nan_to_num(distance[i, j], nan=np.inf))
        rows.append(
            (name, str(len(same)), ", ".join(f"`{other}`" for other in alike) or "none",
             f"{distance[i, i]:.3g}", f"{distance[i, nearest]:.3g} (`{EFFECTS[nearest]}`)")
        )  # fmt: skip
    return rows
