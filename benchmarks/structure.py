"""Print how the code is built, before and after the redesign: sizes, copies of equations, places to touch.

    python -m benchmarks.structure [--before 8d2895f] [--after HEAD]

Both sides are read through git. A function's lines are counted without its docstring. An equation is counted by the
functions of the numeric packages in whose text its pattern stands; `blindcheck` is left out, because the generator of
hidden effects shares no code with the model on purpose.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

PACKAGES = (
    "api", "bench", "storage", "acquisition", "processing", "modeling", "diagnosis", "blindcheck", "reporting",
    "visualization", "panel", "commands",
)  # fmt: skip
LONG_LINES, MANY_PARAMETERS = 60, 8
EQUATIONS = {
    "Eq. 16, open-circuit voltage": r"1\.0 - [\w.\[\]]*beta[\w.\]]* \* \(1\.0 - ",
    "lever or displacement of the mechanism": (
        r"\b(r|[\w.]*radius\w*) \* (np\.sin|math\.sin|sine\b)|1\.0 - (cosine|np\.cos\(|math\.cos\()"
    ),
    "stages of Dormand-Prince 5(4)": r"\bA65\b",
    "means over cells of the crank angle": r"bincount\(",
}
# What an addition touched at 8d2895f, counted by hand: files until the tests were green.
TOUCHED_BEFORE = {"an effect": "4 files, 5 edits", "an instrument": "6 files", "a machine": "several packages"}
# What names an addition; the files of the product that do are what it touches. `blindcheck` hides effects on its own.
ADDED = {"an effect": "cogging_torque", "an instrument": "gsv3", "a machine": "slider_crank_saw"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Function:
    """A function of the product."""

    name: str
    n_lines: int
    n_parameters: int
    text: str
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Tree:
    """What is counted of one commit."""

    lines: Mapping[str, int]
    n_code_lines: int
    functions: tuple[Function, ...]
    product: Mapping[str, str]
    longest_module: tuple[int, str]


def git(*arguments: str) -> bytes:
    return subprocess.run(["git", *arguments], check=True, capture_output=True).stdout


def sources(commit: str) -> dict[str, str]:
    """Every Python and TOML file of a commit that people wrote."""
    with tarfile.open(fileobj=io.BytesIO(git("archive", commit))) as archive:
        return {
            member.name: archive.extractfile(member).read().decode()  # type: ignore[union-attr]
            for member in archive
            if member.name.endswith((".py", ".toml")) and not member.name.endswith("_pb2.py")
        }


def reason_above(lines: list[str], node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """What the comment "# Size: ..." right above a function gives as the reason for its size; empty without one."""
    above = min([node.lineno, *(d.lineno for d in node.decorator_list)]) - 2
    found = ""
    while above >= 0 and lines[above].lstrip().startswith("#"):
        found, above = f"{lines[above].strip('# ')} {found}".strip(), above - 1
    return found.removeprefix("Size: ") if found.startswith("Size: ") else ""


def is_oversized(function: Function) -> bool:
    """Too long, or with too many parameters; a command has as many as options."""
    is_wide = function.n_parameters > MANY_PARAMETERS and not function.name.startswith("commands/")
    return function.n_lines > LONG_LINES or is_wide


def functions_of(path: str, text: str) -> Iterator[Function]:
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0]
            is_documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
            docstring = first.end_lineno - first.lineno + 1 if is_documented else 0  # type: ignore[operator]
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            yield Function(
                name=f"{path}:{node.name}",
                n_lines=node.end_lineno - node.lineno + 1 - docstring,  # type: ignore[operator]
                n_parameters=len([name for name in names if name not in {"self", "cls"}]),
                text="\n".join(lines[node.lineno - 1 : node.end_lineno]),
                reason=reason_above(lines, node),
            )


def count_code(text: str) -> int:
    """Lines that are neither docstring nor comment nor blank."""
    lines = text.splitlines()
    said: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            said |= set(range(node.lineno - 1, node.end_lineno))  # type: ignore[arg-type]
    return sum(k not in said and bool(one.strip()) and not one.lstrip().startswith("#") for k, one in enumerate(lines))


def read_tree(commit: str) -> Tree:
    found = sources(commit)
    files = {path: text for path, text in found.items() if path.endswith(".py")}
    tables = {path: text for path, text in found.items() if path not in files and path.split("/")[0] in PACKAGES}
    product = {path: text for path, text in files.items() if path.split("/")[0] in PACKAGES}
    lines = {
        package: sum(text.count("\n") for path, text in files.items() if path.split("/")[0] == package)
        for package in (*PACKAGES, "tests", "benchmarks")
    }
    functions = tuple(function for path, text in product.items() for function in functions_of(path, text))
    longest = max((text.count("\n"), path) for path, text in product.items())
    return Tree(
        lines=lines,
        n_code_lines=sum(map(count_code, product.values())),
        functions=functions,
        product=product | tables,
        longest_module=longest,
    )


def stated(tree: Tree, pattern: str) -> list[str]:
    """Functions in which an equation stands; of one inside the other, the inner one."""
    where = ("processing/", "modeling/", "diagnosis/", "visualization/")
    found = [f for f in tree.functions if f.name.startswith(where) and re.search(pattern, f.text, re.IGNORECASE)]
    return [f.name for f in found if not any(g is not f and g.text in f.text for g in found)]


def touched(tree: Tree, word: str) -> str:
    """Count the files of the product that name an addition, in their text or by their own name."""
    own = re.compile(rf"\b{word}\b", re.IGNORECASE)
    found = [path for path, text in tree.product.items() if own.search(text) or own.search(path)]
    return f"{len([path for path in found if not path.startswith('blindcheck/')])} files ({word})"


def rows(before: Tree, after: Tree) -> Iterator[tuple[str, str, str]]:
    for package in before.lines:
        yield f"lines, {package}", f"{before.lines[package]:,}", f"{after.lines[package]:,}"
    yield "lines, product", *(f"{sum(tree.lines[p] for p in PACKAGES):,}" for tree in (before, after))
    code = "lines, product, without docstrings, comments and blank lines"
    yield code, *(f"{tree.n_code_lines:,}" for tree in (before, after))
    yield "longest module, lines", *(f"{n} ({path})" for n, path in (before.longest_module, after.longest_module))
    long = [[f for f in tree.functions if f.n_lines > LONG_LINES] for tree in (before, after)]
    yield f"functions over {LONG_LINES} lines", *(str(len(found)) for found in long)
    wide = [
        [f for f in tree.functions if f.n_parameters > MANY_PARAMETERS and not f.name.startswith("commands/")]
        for tree in (before, after)
    ]
    yield f"functions over {MANY_PARAMETERS} parameters, options of commands aside", *(str(len(w)) for w in wide)
    bare = [[f for f in tree.functions if is_oversized(f) and not f.reason] for tree in (before, after)]
    yield "of these, without a reason above them", *(str(len(found)) for found in bare)
    for name, pattern in EQUATIONS.items():
        yield f"functions that state: {name}", *(str(len(stated(tree, pattern))) for tree in (before, after))
    for name, word in ADDED.items():
        yield f"files to touch for {name}", TOUCHED_BEFORE[name], touched(after, word)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", default="8d2895f")
    parser.add_argument("--after", default="HEAD")
    parser.add_argument("--list", action="store_true", help="Name the functions that are counted, after.")
    chosen = parser.parse_args()
    before, after = read_tree(chosen.before), read_tree(chosen.after)
    print(f"| what | {chosen.before} | {chosen.after} |\n|---|---|---|")
    for row in rows(before, after):
        print(f"| {' | '.join(row)} |")
    if chosen.list:
        for function in after.functions:
            if is_oversized(function):
                size = f"{function.n_lines:4} lines {function.n_parameters:3} parameters"
                print(f"{size}  {function.name}: {function.reason or 'no reason stated'}")
        for name, pattern in EQUATIONS.items():
            print(f"{name}: {', '.join(stated(after, pattern))}")


if __name__ == "__main__":
    main()
