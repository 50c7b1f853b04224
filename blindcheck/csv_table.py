"""Fast writing of a table of numbers as CSV with a fixed number of decimals per column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

_MINUS, _DOT, _COMMA, _NEWLINE, _ZERO = (ord(letter) for letter in "-.,\n0")
_WIDTH = 24


@njit(cache=True)
def _print_rows(scaled, decimals, buffer):
    """Write integers `scaled` (value * 10**decimals) as text; returns the number of bytes."""
    end = 0
    digits = np.empty(20, dtype=np.uint8)
    for row in range(scaled.shape[0]):
        for col in range(scaled.shape[1]):
            value = scaled[row, col]
            if value < 0:
                buffer[end] = _MINUS
                end += 1
                value = -value
            n = 0
            while value > 0 or n <= decimals[col]:
                digits[n] = value % 10
                value //= 10
                n += 1
            while n > 0:
                n -= 1
                buffer[end] = _ZERO + digits[n]
                end += 1
                if n == decimals[col] and n > 0:
                    buffer[end] = _DOT
                    end += 1
            buffer[end] = _COMMA
            end += 1
        buffer[end - 1] = _NEWLINE
    return end


def csv_bytes(columns: dict[str, NDArray[np.float64]], decimals: dict[str, int]) -> bytes:
    r"""Return a CSV table with a header line.

    Parameters
    ----------
    columns : dict of str to ndarray, each shape (n,)
        Finite values below 1e9.
    decimals : dict of str to int
        Digits after the point, 0..9, by column.

    Examples
    --------
    >>> import numpy as np
    >>> csv_bytes({"a": np.array([-0.5, 12.0]), "b": np.array([3.0, 4.26])}, {"a": 2, "b": 1})
    b'a,b\n-0.50,3.0\n12.00,4.3\n'
    """
    places = np.array([decimals[name] for name in columns], dtype=np.int64)
    table = np.column_stack(list(columns.values())) * 10.0**places
    scaled = np.rint(table).astype(np.int64)
    buffer = np.empty(scaled.size * _WIDTH, dtype=np.uint8)
    end = _print_rows(scaled, places, buffer)
    return ",".join(columns).encode() + b"\n" + buffer[:end].tobytes()


def write_csv(path: Path, columns: dict[str, NDArray[np.float64]], decimals: dict[str, int]) -> None:
    """Write `csv_bytes` to a file."""
    path.write_bytes(csv_bytes(columns, decimals))
