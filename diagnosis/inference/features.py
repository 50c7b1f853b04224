"""From residuals on a grid to the numbers that are compared: harmonics over the crank angle, in time blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.residuals import EQUATIONS, Equation, Signature
from sawbench.modeling.state import State

HARMONICS: Final[Mapping[Equation, int]] = MappingProxyType(
    {"electrical": 12, "mechanical": 8, "cutting": 32, "supply": 4, "converter": 6}
)
N_BLOCKS: Final = 4
# Edges of the start-up's time bins, s after the motion begins.
START_UP_EDGES_S: Final = (
    0.0,
    0.003,
    0.006,
    0.01,
    0.015,
    0.022,
    0.032,
    0.045,
    0.06,
    0.08,
    0.11,
    0.15,
    0.2,
    0.28,
    0.4,
)
START_UP_EQUATIONS: Final[tuple[Equation, ...]] = ("electrical", "supply", "converter")


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """Which equations a trial has, in which order they stand in its feature vector.

    Attributes
    ----------
    kind : {"running", "start_up"}
    equations : tuple of str
    n_harmonics : mapping of str to int
        Harmonics that are compared; those of the jigsaw where nothing else is said.
    """

    kind: str
    equations: tuple[Equation, ...]
    n_harmonics: Mapping[Equation, int] = field(default_factory=lambda: HARMONICS)

    @property
    def slices(self) -> dict[Equation, slice]:
        """Place of each equation in a feature vector."""
        found, start = {}, 0
        for equation in self.equations:
            size = 2 * self.n_harmonics[equation] + 1 if self.kind == "running" else len(START_UP_EDGES_S) - 1
            found[equation] = slice(start, start + size)
            start += size
        return found

    @property
    def orders(self) -> dict[Equation, Floats]:
        """Order of the harmonic that each feature of an equation is; 0 for the bins of a start-up."""
        n_bins = len(START_UP_EDGES_S) - 1
        return {
            equation: orders(self.n_harmonics[equation]) if self.kind == "running" else np.zeros(n_bins)
            for equation in self.equations
        }

    @property
    def size(self) -> int:
        """Length of a feature vector."""
        return max((part.stop for part in self.slices.values()), default=0)

    def place(self, signature: Signature, times: Floats) -> Floats:
        """Feature vectors of a residual or a signature, shape (n_units, size); absent equations are 0.

        Of a running machine, harmonics over the crank angle of what counts by its time. The mean over time of a speed
        is the turns made, and that of an acceleration is none, however the angle is read within the stroke; over the
        angle, a speed that is read to swing by a fifth has a mean that is a fiftieth too large, and a torque with it.

        Parameters
        ----------
        signature : dict
            Arrays of shape (n_units, n_points).
        times : ndarray, shape (n_units, n_points)
            Of `times_over_angles`, the same for a residual and for the signatures that it is compared with: what the
            speed is read to do within the stroke would otherwise be left of every strong effect.
        """
        out = np.zeros((len(times), self.size))
        places = {equation: part for equation, part in self.slices.items() if equation in signature}
        if self.kind != "running":
            for equation, part in places.items():
                out[:, part] = time_bins(signature[equation])
            return out
        for equation, part in places.items():
            out[:, part] = harmonics(times * signature[equation], self.n_harmonics[equation])
        return out


def layout_of(state: State, residual: Signature, n_harmonics: Mapping[Equation, int]) -> Layout:
    """Layout of the equations that a state's residuals hold."""
    allowed = EQUATIONS if state.kind == "running" else START_UP_EQUATIONS
    return Layout(kind=state.kind, equations=tuple(e for e in allowed if e in residual), n_harmonics=n_harmonics)


def times_over_angles(state: State) -> Floats:
    """Time that the crank takes over each angle, 1 on average of a stroke, shape (n_units, n_points); 1 in a start."""
    if state.kind != "running":
        return np.ones_like(state.speed_rad_s)
    return np.broadcast_to(state.motion.times, state.speed_rad_s.shape)


def harmonics(waves: Floats, n: int) -> Floats:
    """Mean, cosine and sine amplitudes of periodic rows, shape (n_units, 2 n + 1)."""
    spectrum = np.fft.rfft(waves, axis=-1)[..., : n + 1] / waves.shape[-1]
    return np.concatenate([spectrum[..., :1].real, 2 * spectrum[..., 1:].real, -2 * spectrum[..., 1:].imag], axis=-1)


def up_to_harmonic(waves: Floats, n: int) -> Floats:
    """Periodic rows without what is above a harmonic, shape of `waves`."""
    spectrum = np.fft.rfft(waves, axis=-1)
    spectrum[..., n + 1 :] = 0.0
    return np.fft.irfft(spectrum, waves.shape[-1], axis=-1)


def orders(n: int) -> Floats:
    """Order of each amplitude that `harmonics` gives, shape (2 n + 1,)."""
    return np.concatenate([[0.0], *2 * [np.arange(1.0, n + 1)]])


def wave_of(series: Floats, angle_rad: Floats) -> Floats:
    """Value at some angles of a series as `harmonics` gives it, shape of `angle_rad`."""
    n = (len(series) - 1) // 2
    turns = np.outer(np.arange(1, n + 1), angle_rad)
    return series[0] + series[1 : n + 1] @ np.cos(turns) + series[n + 1 :] @ np.sin(turns)


def time_bins(rows: Floats) -> Floats:
    """Means over the start-up's time bins, shape (1, n_bins); rows on a 1 ms grid from the first motion on."""
    from sawbench.modeling.state import START_UP_STEP_S

    edges = np.round(np.array(START_UP_EDGES_S) / START_UP_STEP_S).astype(int)
    return np.stack([rows[..., a:b].mean(axis=-1) for a, b in pairwise(edges)], axis=-1)


def block_matrix(n_units: int, n_blocks: int = N_BLOCKS) -> Floats:
    """Average of units into time blocks, shape (n_blocks, n_units); fewer blocks where there are few units."""
    n_blocks = max(1, min(n_blocks, n_units // 3))
    edges = np.linspace(0, n_units, n_blocks + 1).round().astype(int)
    matrix = np.zeros((n_blocks, n_units))
    for block, (a, b) in enumerate(pairwise(edges)):
        matrix[block, a:b] = 1.0 / (b - a)
    return matrix
