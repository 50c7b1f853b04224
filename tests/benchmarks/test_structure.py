"""The counts of the structure table are what they say."""

from __future__ import annotations

import pytest

from benchmarks.structure import EQUATIONS, Tree, functions_of, stated

pytestmark = pytest.mark.unit

SOURCE = '''
class Part:
    def step(self, a, b, *, c):
        """Two lines
        that do not count."""
        return a + b + c


def lever(angle, radius):
    def inner():
        return radius * np.sin(angle)

    return inner()
'''


def test_functions_are_counted_without_docstring_and_self():
    found = {f.name: f for f in functions_of("modeling/part.py", SOURCE)}
    assert set(found) == {"modeling/part.py:step", "modeling/part.py:lever", "modeling/part.py:inner"}
    step = found["modeling/part.py:step"]
    assert (step.n_lines, step.n_parameters) == (2, 3)


def test_an_equation_counts_once_where_it_stands():
    functions = (*functions_of("modeling/part.py", SOURCE), *functions_of("blindcheck/own.py", SOURCE))
    tree = Tree(lines={}, functions=functions, longest_module=(0, ""))
    assert stated(tree, EQUATIONS["lever or displacement of the mechanism"]) == ["modeling/part.py:inner"]
    assert stated(tree, EQUATIONS["stages of Dormand-Prince 5(4)"]) == []
