"""The counts of the structure table are what they say."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.structure import EQUATIONS, PACKAGES, Tree, count_code, functions_of, is_oversized, stated, touched

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
    tree = Tree(lines={}, n_code_lines=0, functions=functions, product={}, longest_module=(0, ""))
    assert stated(tree, EQUATIONS["lever or displacement of the mechanism"]) == ["modeling/part.py:inner"]
    assert stated(tree, EQUATIONS["stages of Dormand-Prince 5(4)"]) == []


def test_an_addition_touches_the_files_that_name_it():
    product = {
        "modeling/drag.py": "",
        "modeling/table.py": "DRAG, drag",
        "modeling/a.py": "dragging",
        "blindcheck/a.py": "drag",
    }
    tree = Tree(lines={}, n_code_lines=0, functions=(), product=product, longest_module=(0, ""))
    assert touched(tree, "drag") == "2 files (drag)"


WIDE = """
# Size: nine numbers,
# each on its own.
@compiled
def f(a, b, c, d, e, f, g, h, i): ...

# No reason.
def g(a, b, c, d, e, f, g, h, i): ...
"""


def test_a_reason_for_the_size_stands_right_above_the_function():
    found = {f.name.split(":")[1]: f for f in functions_of("modeling/part.py", WIDE)}
    assert found["f"].reason == "nine numbers, each on its own."
    assert found["g"].reason == ""
    assert is_oversized(found["g"])
    assert not is_oversized(next(iter(functions_of("commands/part.py", WIDE))))


def test_every_function_of_more_than_60_lines_or_8_parameters_says_why():
    root = Path(__file__).parents[2]
    bare = [
        function.name
        for package in PACKAGES
        for path in sorted((root / package).rglob("*.py"))
        if not path.name.endswith("_pb2.py")
        for function in functions_of(path.relative_to(root).as_posix(), path.read_text(encoding="utf-8"))
        if is_oversized(function) and not function.reason
    ]
    assert not bare, f'split them, or write "# Size: ..." with the reason above: {", ".join(bare)}'


def test_code_is_counted_without_what_explains_it():
    said = '"""What it is."""\n\n# Why.\n'
    text = said + 'X = "a text"\n\n\ndef f():\n    """Return one.\n\n    More.\n    """\n    return 1  # one\n'
    assert count_code(text) == 3
