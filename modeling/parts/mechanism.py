"""The mechanism of a machine for whoever works on arrays: lever, displacement, and the angle that belongs to one.

The equations themselves stand in `scotch_yoke` and `slider_crank`; the kernels compile those, this calls the
same functions elementwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from sawbench.bench.recording import Floats

if TYPE_CHECKING:
    from sawbench.bench.config import PlantConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class Mechanism:
    """Crank and what hangs on it.

    Attributes
    ----------
    radius_m : float or ndarray
        Crank radius, half the stroke; an array where it drifts, one value an angle.
    rod_length_m : float or None
        Connecting rod of an in-line slider-crank; None for a Scotch yoke.
    """

    radius_m: float | Floats
    rod_length_m: float | None = None

    @classmethod
    def of(cls, plant: PlantConfig) -> Self:
        """Take the nominal lengths of the `[plant]` table."""
        rod_length_m = plant.rod_length_m if plant.mechanism == "slider_crank" else None
        return cls(radius_m=plant.crank_radius_m.nominal, rod_length_m=rod_length_m)

    def levers(self, angle_rad: Floats) -> tuple[Floats, Floats]:
        """First and second derivative of the displacement by the crank angle.

        Parameters
        ----------
        angle_rad : ndarray
            Crank angle, 0 at the dead centre with the smallest displacement; any shape.

        Returns
        -------
        lever, slope : ndarray
            dy/dphi and d2y/dphi2 in m, of the shape of `angle_rad`.
        """
        from sawbench.modeling.parts import scotch_yoke, slider_crank

        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        if self.rod_length_m is None:
            return scotch_yoke.lever.py_func(sine, cosine, self.radius_m)
        return slider_crank.lever.py_func(sine, cosine, self.radius_m, self.rod_length_m)

    def lever(self, angle_rad: Floats) -> Floats:
        """dy/dphi in m, of the shape of `angle_rad`."""
        return self.levers(angle_rad)[0]

    def sliding_lever(self, angle_rad: Floats) -> Floats:
        """Path that the blade's side force slides along, a radian of the crank and a newton of blade force, m.

        Of a Scotch yoke the block slides in its slot under the blade force itself, r |cos|. Of a slider-crank the rod
        presses the blade's guide with the tangent of its angle, and the blade slides there. Shape of `angle_rad`.
        """
        if self.rod_length_m is None:
            return self.radius_m * np.abs(np.cos(angle_rad))
        lean = self.radius_m / self.rod_length_m * np.sin(angle_rad)
        return np.abs(self.lever(angle_rad) * lean) / np.sqrt(1.0 - lean**2)

    def displacement(self, angle_rad: Floats) -> Floats:
        """Displacement from the dead centre at angle 0, m, of the shape of `angle_rad`.

        Examples
        --------
        >>> Mechanism(radius_m=0.01, rod_length_m=0.025).displacement(np.array([0.0, np.pi])).round(12).tolist()
        [0.0, 0.02]
        """
        from sawbench.modeling.parts import scotch_yoke, slider_crank

        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        if self.rod_length_m is None:
            return scotch_yoke.displacement.py_func(sine, cosine, self.radius_m)
        return slider_crank.displacement.py_func(sine, cosine, self.radius_m, self.rod_length_m)

    def position(self, angle_rad: Floats) -> tuple[Floats, Floats]:
        """Displacement, m, and its first derivative by the crank angle, m/rad, of the shape of `angle_rad`."""
        from sawbench.modeling.parts import scotch_yoke, slider_crank

        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        if self.rod_length_m is None:
            part, lengths = scotch_yoke, (self.radius_m,)
        else:
            part, lengths = slider_crank, (self.radius_m, self.rod_length_m)
        return part.displacement.py_func(sine, cosine, *lengths), part.lever.py_func(sine, cosine, *lengths)[0]

    def half_turn(self, displacement_m: Floats) -> Floats:
        """Crank angle in [0, pi] at which the blade has a displacement, rad; clipped to the stroke.

        Of a slider-crank by the law of cosines on the triangle of crank, rod and stroke line.

        Examples
        --------
        >>> crank = Mechanism(radius_m=0.01, rod_length_m=0.025)
        >>> crank.half_turn(crank.displacement(np.array([0.3, 2.0]))).round(9).tolist()
        [0.3, 2.0]
        """
        radius, rod = self.radius_m, self.rod_length_m
        if rod is None:
            cosine = 1.0 - displacement_m / radius
        else:
            reach = radius + rod - np.clip(displacement_m, 0.0, 2.0 * radius)
            cosine = (reach**2 + radius**2 - rod**2) / (2.0 * radius * reach)
        return np.arccos(np.clip(cosine, -1.0, 1.0))
