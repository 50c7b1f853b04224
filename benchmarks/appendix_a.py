"""Published figures as rows, and Appendix A: runtimes from mean currents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

USABLE_CHARGE_A_S: Final = 0.8 * 9000.0  # Eq. A.1
APPENDIX_A_CURRENT_A: Final = {"measured": 8.51, "linear": 7.77, "nonlinear": 8.24}


@dataclass(frozen=True, kw_only=True, slots=True)
class PaperRow:
    """One published figure beside ours.

    Attributes
    ----------
    quantity, unit, published : str
    value : float
        Computed here.
    target : float or None
        Published number; None where there is nothing to compare with.
    tolerance : float
        Largest deviation from `target` that counts as reproduced, in `unit`.
    digits : int
        Decimals shown.
    reading : str
        What was assumed.
    """

    quantity: str
    unit: str
    published: str
    value: float
    target: float | None
    tolerance: float
    digits: int
    reading: str

    @property
    def is_reproduced(self) -> bool | None:
        """Whether the value lies within the tolerance; None where there is nothing to compare with."""
        return None if self.target is None else abs(self.value - self.target) <= self.tolerance


def appendix_a_rows() -> tuple[PaperRow, ...]:
    """Equations A.3 to A.7 from the published currents."""
    runtime_s = {name: USABLE_CHARGE_A_S / current for name, current in APPENDIX_A_CURRENT_A.items()}
    longer = {name: 100.0 * (value / runtime_s["measured"] - 1.0) for name, value in runtime_s.items()}
    published_s = {"measured": 846.0, "linear": 926.96, "nonlinear": 873.8}
    published_percent = {"linear": 9.6, "nonlinear": 3.3}
    equation = {"measured": "A.3", "linear": "A.4", "nonlinear": "A.5"}
    rows = [
        PaperRow(
            quantity=f"Appendix A, runtime, {name}",
            unit="s",
            published=f"{published_s[name]:g} (Eq. {equation[name]})",
            value=runtime_s[name],
            target=published_s[name],
            tolerance=0.5,
            digits=1,
            reading=f"7200 A*s / {APPENDIX_A_CURRENT_A[name]} A",
        )
        for name in runtime_s
    ]
    rows += [
        PaperRow(
            quantity=f"Appendix A, {name} longer than measured",
            unit="%",
            published=f"{published_percent[name]} (Eq. {number})",
            value=longer[name],
            target=published_percent[name],
            tolerance=0.15,
            digits=1,
            reading="from the rows above",
        )
        for name, number in (("linear", "A.6"), ("nonlinear", "A.7"))
    ]
    rows.append(
        PaperRow(
            quantity="runtime error of the abstract",
            unit="%",
            published="3.7",
            value=100.0 * (963.0 - 927.0) / 963.0,
            target=3.7,
            tolerance=0.05,
            digits=1,
            reading="963 s against 927 s, two simulations; against the measured 846 s it is 9.6 %",
        )
    )
    return tuple(rows)
