"""The whitened linear problem: features of all trials, their noise, and everything that may be mistuned.

The residuals are linear in the errors of the parameters and in the strength of an effect, so with Gaussian noise C
and Gaussian priors Lambda on the nuisances N, the nuisances are integrated out exactly: M = C + N Lambda N'. Here
everything is kept whitened by C (a Cholesky factor per block), and M is never formed (Woodbury).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.features import Layout, block_matrix, layout_of, times_over_angles
from sawbench.diagnosis.inference.noise import contrast_misfit, noise_of, scatter_of
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.diagnosis.inference.sensor_faults import ROUNDING, SensorFaults
from sawbench.diagnosis.inference.settings import SETTINGS, Settings
from sawbench.diagnosis.inference.zero_wander import ZeroWander
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.residuals import Equation, Signature, summed
from sawbench.modeling.state import TWO_PI, State, TrialSetting

_ZERO = "zero of the force"
# Before the name of a known effect, in the names of the columns for what its form may leave.
FORM_OF_KNOWN = "form of "


@dataclass(frozen=True, kw_only=True)
class Part:
    """Features of one state; without slots, for what is worked out once and kept here.

    Attributes
    ----------
    state, smooth : State
        As measured, and for signatures (one row a block).
    layout : Layout
    blocks : ndarray, shape (n_blocks, n_units)
        Average of units into time blocks.
    whitener : ndarray, shape (size, size)
        Inverse Cholesky factor of the covariance of one block.
    common : ndarray, shape (size, size)
        Whitened covariance of what no repetition shows: the same in every block and every repeat, at most 1 in any
        direction.
    scatter : ndarray, shape (size,)
        Root mean square of each whitened feature that the scatter of single strokes predicts; 0 where they are few.
    times : ndarray, shape (n_blocks, n_points)
        Time over each angle, 1 on average, of the strokes of a block: what residuals and signatures are weighted by.
    place : slice
        Of this part in the stacked vector.
    """

    state: State
    smooth: State
    layout: Layout
    times: Floats
    blocks: Floats
    whitener: Floats
    common: Floats
    scatter: Floats
    place: slice

    @property
    def setting(self) -> TrialSetting:
        """Of the trial."""
        return self.state.setting

    def whiten(self, signature: Signature) -> Floats:
        """Stacked whitened features of a signature on the grid of `smooth`."""
        return self.whiten_all([signature])[0]

    def whiten_all(self, signatures: Sequence[Signature]) -> Floats:
        """`whiten` of many signatures at once, shape (len(signatures), n_blocks * size)."""
        shape = self.smooth.angle_rad.shape
        found = np.zeros((len(signatures), shape[0], self.layout.size))
        for equation, place in self.layout.slices.items():
            there = [k for k, signature in enumerate(signatures) if equation in signature]
            waves = np.empty((len(there), *shape))
            for wave, k in zip(waves, there, strict=True):
                wave[:] = signatures[k][equation]
            features = (self.times * waves).reshape(-1, shape[1]) @ self._of_points[equation]
            # The whitener is a lower triangle: what stands before the equation in a feature vector stays as it is.
            rows = features @ self.whitener[place.start :, place].T
            found[there, :, place.start :] += rows.reshape(len(there), shape[0], rows.shape[1])
        return found.reshape(len(signatures), -1)

    @cached_property
    def _of_points(self) -> dict[Equation, Floats]:
        """Features of a one at each point of the grid, by equation, shape (n_points, n): all is linear in these."""
        ones = np.eye(self.smooth.angle_rad.shape[1])
        slices = self.layout.slices
        return {name: self.layout.place({name: ones}, np.ones_like(ones))[:, slices[name]] for name in slices}

    def unwhiten(self, stacked: Floats) -> Floats:
        """Features of this part, in the units of their equations, shape (n_blocks, size), from the stacked vector."""
        from scipy.linalg import solve_triangular

        rows = stacked[self.place].reshape(-1, self.layout.size)
        return np.asarray(solve_triangular(self.whitener, rows.T, lower=True).T)


@dataclass(frozen=True, kw_only=True, slots=True)
class LinearProblem:
    """All features of a campaign with the nuisances.

    Attributes
    ----------
    campaign : Campaign
    parts : tuple of Part
    data : ndarray, shape (n,)
        Whitened residuals of the nominal baseline.
    known : ndarray, shape (n,)
        Whitened signature of the effects that the model has: taken off the data.
    nuisance : ndarray, shape (n, p)
        Whitened signatures, times their prior standard deviation.
    names : tuple of str
    prior_std : ndarray, shape (p,)
    quiet : float
        Whitened misfit over features that an intact machine leaves on this bench: what its scatter says, but no less
        than `Weights.quiet`.
    settings : Settings
    wander : ZeroWander or None
        Of the zero of the force; None where the campaign cannot tell.
    """

    campaign: Campaign
    parts: tuple[Part, ...]
    data: Floats
    known: Floats
    nuisance: Floats
    names: tuple[str, ...]
    prior_std: Floats
    quiet: float = SETTINGS.weights.quiet
    settings: Settings = SETTINGS
    wander: ZeroWander | None = None

    @property
    def is_of_trial(self) -> np.ndarray:
        """Whether a nuisance is that of single trials: hardness of a piece, zero of a sensor; of bool, shape (p,)."""
        listed = self.campaign.plant.trial_nuisances(self.campaign.states)
        own = {nuisance.name for nuisance in listed if not nuisance.is_shared}
        return np.array([name in own or name.startswith((_ZERO, ROUNDING)) for name in self.names], dtype=bool)

    def only(self, is_kept: Callable[[str], bool]) -> LinearProblem:
        """The problem with those nuisances whose name is kept."""
        kept = np.array([is_kept(name) for name in self.names], dtype=bool)
        names = tuple(name for name, is_one in zip(self.names, kept, strict=True) if is_one)
        return replace(self, nuisance=self.nuisance[:, kept], names=names, prior_std=self.prior_std[kept])

    def project(self, signature: Callable[[State], Signature]) -> Floats:
        """Whitened features of a signature evaluated on every state, shape (n,)."""
        out = np.zeros(len(self.data))
        for part in self.parts:
            found = signature(part.smooth)
            if any(name in part.layout.equations for name in found):
                out[part.place] = part.whiten(found)
        return out

    def rows(self, keep: Callable[[TrialSetting], bool]) -> np.ndarray:
        """Mask of the features of trials that `keep` accepts, shape (n,)."""
        mask = np.zeros(len(self.data), dtype=bool)
        for part in self.parts:
            mask[part.place] = keep(part.setting)
        return mask

    @property
    def wide_scale(self) -> Floats:
        """Factor on the prior of each nuisance where the plant is re-tuned freely: that of its numbers alone, (p,)."""
        return self._wide(is_effect=False)

    @property
    def wide_if_less(self) -> Floats:
        """The same of the numbers that are an effect of the catalogue where they are more than stated, shape (p,)."""
        return self._wide(is_effect=True)

    def scale_of(self, freed: Collection[str]) -> Floats:
        """Factor on the prior of each nuisance where the numbers of those names are re-tuned freely, shape (p,)."""
        return np.where(np.isin(self.names, list(freed)), np.maximum(self.wide_scale, self.wide_if_less), 1.0)

    def _wide(self, *, is_effect: bool) -> Floats:
        plant = {n.name for n in self.campaign.plant.nuisances() if n.is_plant and n.is_effect == is_effect}
        return np.array([self.settings.noise.wide if name in plant else 1.0 for name in self.names])

    def rows_by_equation(self) -> dict[tuple[Equation, str], np.ndarray]:
        """Indices of the features of each equation, running and starting apart."""
        found: dict[tuple[Equation, str], list[np.ndarray]] = {}
        for part in self.parts:
            rows = np.arange(part.place.start, part.place.stop).reshape(-1, part.layout.size)
            for equation, place in part.layout.slices.items():
                found.setdefault((equation, part.state.kind), []).append(rows[:, place].ravel())
        return {key: np.concatenate(rows) for key, rows in found.items()}

    def sums_by_equation(self, values: Floats) -> dict[Equation, float]:
        """Sum of one value a feature, shape (n,), over those of each equation."""
        found: dict[Equation, float] = {}
        for (equation, _), rows in self.rows_by_equation().items():
            found[equation] = found.get(equation, 0.0) + float(values[rows].sum())
        return found


def build_problem(campaign: Campaign, *, settings: Settings = SETTINGS) -> LinearProblem:
    """Lay out features, noise and nuisances of a campaign.

    Parameters
    ----------
    campaign : Campaign
    settings : Settings

    Returns
    -------
    LinearProblem
    """
    plant = campaign.plant
    n_harmonics: dict[Equation, int] = {equation: form.n_harmonics for equation, form in plant.equations.items()}
    found = []
    for state in campaign.states:
        residual = plant.residuals(state)
        layout = layout_of(state, residual, n_harmonics)
        if layout.equations:
            found.append((state, layout, layout.place(residual, times_over_angles(state))))
    scatter = scatter_of(found)
    rates = [float(state.speed_rad_s.mean()) / TWO_PI for state, _, _ in found if state.kind == "running"]
    rate_hz = float(np.mean(rates)) if rates else 1.0
    faults = SensorFaults(campaign)
    parts: list[Part] = []
    expected = 0.0
    data: list[Floats] = []
    taken: list[Floats] = []
    start = 0
    for state, layout, features in found:
        blocks = block_matrix(len(features)) if state.kind == "running" else np.eye(1)
        noise = noise_of(state, layout, blocks, scatter, rate_hz)
        missed = plant.model_error(layout, state) + np.diag(faults.variance(layout, state))
        covariance = missed + settings.noise.correlation_factor * noise
        whitener: Floats = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
        size = blocks.shape[0] * layout.size
        part = Part(
            state=state, smooth=plant.smooth(state, blocks), layout=layout, blocks=blocks, whitener=whitener,
            times=blocks @ times_over_angles(state),
            common=whitener @ missed @ whitener.T, place=slice(start, start + size),
            scatter=np.sqrt(np.einsum("ij,jk,ik->i", whitener, noise, whitener)),
        )  # fmt: skip
        parts.append(part)
        taken.append(part.whiten(summed([one.signature(plant.model, part.smooth) for one in plant.known])))
        data.append(((blocks @ features) @ whitener.T).ravel() - taken[-1])
        expected += blocks.shape[0] * float(part.scatter @ part.scatter)
        start += size
    contrasts = contrast_misfit([d.reshape(-1, p.layout.size) for d, p in zip(data, parts, strict=True)])
    empty = LinearProblem(
        campaign=campaign,
        parts=tuple(parts),
        data=np.concatenate(data),
        known=np.concatenate(taken),
        nuisance=np.zeros((start, 0)),
        names=(),
        prior_std=np.zeros(0),
        quiet=min(
            max(
                settings.weights.quiet,
                plant.expected_rest,
                settings.noise.quiet_share * max(expected / start, contrasts),
            ),
            1.0,
        ),
        settings=settings,
    )
    return _with_readings(_with_nuisances(empty, [one for state in campaign.states for one in faults.roundings(state)]))


def _with_readings(problem: LinearProblem) -> LinearProblem:
    """Add a row, of no state, for each number of the plant that a channel reads by itself."""
    nominal = {nuisance.name: nuisance.nominal for nuisance in problem.campaign.plant.nuisances()}
    read = {name: of for name, of in problem.campaign.read.items() if name in problem.names}
    rows = np.zeros((len(read), len(problem.names)))
    for row, (name, (_, std)) in zip(rows, read.items(), strict=True):
        place = problem.names.index(name)
        row[place] = problem.prior_std[place] / std
    return replace(
        problem, known=np.append(problem.known, np.zeros(len(read))),
        nuisance=np.hstack([problem.nuisance.T, rows.T]).T,  # column by column in memory, as it was
        data=np.append(problem.data, [(value - nominal[name]) / std for name, (value, std) in read.items()]),
    )  # fmt: skip


def _with_nuisances(problem: LinearProblem, roundings: Sequence[Nuisance]) -> LinearProblem:
    campaign, plant = problem.campaign, problem.campaign.plant

    def column_of(nuisance: Nuisance) -> Floats:
        return nuisance.std * problem.project(lambda s: nuisance.signature(plant.model, s))

    listed = [(nuisance, 0.0) for nuisance in (*plant.nuisances(), *plant.trial_nuisances(campaign.states))]
    listed += [(rounding, 1.0) for rounding in roundings]  # what noise hides needs no number
    found = zip(listed, on_two_cores(column_of, [nuisance for nuisance, _ in listed]), strict=True)
    shown = [(nuisance, column) for (nuisance, least), column in found if float(column @ column) > least]
    columns = [column for _, column in shown]
    names, stds = [nuisance.name for nuisance, _ in shown], [nuisance.std for nuisance, _ in shown]
    share = problem.settings.forms.screen_share
    for known in plant.known:
        missed = missed_by_form(problem, known)
        columns += list(share * missed.T)
        names += [f"{FORM_OF_KNOWN}{known.effect.name} {k}" for k in range(missed.shape[1])]
        stds += [share] * missed.shape[1]
    wander = plant.zero_wander(campaign.states)
    zeros = [] if wander is None else zero_modes(problem, wander)
    return replace(
        problem, nuisance=np.array([*columns, *zeros]).T, wander=wander,
        names=(*names, *(f"{_ZERO}, mode {k + 1}" for k in range(len(zeros)))),
        prior_std=np.array([*stds, *np.ones(len(zeros))]),
    )  # fmt: skip


def zero_modes(problem: LinearProblem, wander: ZeroWander) -> list[Floats]:
    """Columns of the wandering zero, times their standard deviation: the Karhunen-Loeve modes that can be seen.

    Parameters
    ----------
    problem : LinearProblem
        Of which parts and the length of the data are used.
    wander : ZeroWander

    Returns
    -------
    list of ndarray, shape (n,)
    """
    plant = problem.campaign.plant
    parts = [p for p in problem.parts if p.state.kind == "running" and p.state.force_n is not None]
    if not parts:
        return []
    rows = [p.whiten(plant.zero_signature(p.smooth)).reshape(-1, p.layout.size) for p in parts]
    at_s = np.concatenate([p.setting.session_s + p.smooth.time_s[:, 0] for p in parts])
    trial = np.concatenate([np.full(len(r), k) for k, r in enumerate(rows)])
    values, vectors = np.linalg.eigh(wander.covariance(at_s, trial))
    # Wander that is smaller than the floor of the force, on average over the time blocks, needs no mode.
    floor_n, _ = problem.settings.sensors.floor["cutting"]
    unseen = np.cumsum(np.maximum(values, 0.0)) < len(at_s) * floor_n**2
    found = []
    for value, vector in zip(values[~unseen], vectors.T[~unseen], strict=True):
        column = np.zeros(len(problem.data))
        for k, (part, row) in enumerate(zip(parts, rows, strict=True)):
            column[part.place] = (np.sqrt(value) * vector[trial == k, None] * row).ravel()
        found.append(column)
    return found


def missed_by_form(problem: LinearProblem, known: KnownEffect) -> Floats:
    """Columns for what the form of a known effect may leave, shape (n, q); see `diagnosis.inference.form_error`."""
    from sawbench.diagnosis.inference.form_error import form_modes

    model = problem.campaign.plant.model
    contribution = problem.project(lambda state: known.signature(model, state))
    # The class is one; a type checker sees it under the folder's name here and under the package's there.
    return form_modes(problem, contribution)  # pyright: ignore[reportArgumentType]
