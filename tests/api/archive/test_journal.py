"""A batch whose results are files does every piece once, and continues where it stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from sawbench.archive.batch import Workers
from sawbench.archive.journal import Journal, Piece
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.storage.places import JOURNAL

pytestmark = pytest.mark.unit


def written(request: tuple[Path, str]) -> dict[str, int]:
    """Write a text to its target; a text that is "bad" is refused."""
    target, text = request
    if text == "bad":
        raise InputError("is bad", where=target.name, remedy="mend it")
    target.write_text(text)
    return {"n_characters": len(text)}


def pieces_of(folder, texts):
    return [
        Piece(name=name, key=text, target=folder / name, request=(folder / name, text)) for name, text in texts.items()
    ]


def run(folder, pieces, *, jobs=1, **options):
    """Rows by name; which of them were worked on now."""
    rows = {row.name: row for row in Journal(folder, **options).run(written, pieces, Workers(jobs=jobs))}
    return rows, sorted(name for name, row in rows.items() if not row.was_done)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_second_run_does_nothing_and_still_names_the_bad_piece(tmp_path, jobs):
    pieces = pieces_of(tmp_path, {"a": "one", "b": "bad", "c": "three"})
    assert run(tmp_path, pieces, jobs=jobs)[1] == ["a", "b", "c"]
    rows, now = run(tmp_path, pieces, jobs=jobs)
    assert now == []
    assert (rows["a"].result, rows["b"].result) == ({"n_characters": 3}, {})
    assert (rows["b"].error, rows["b"].remedy, rows["b"].exit_code) == ("b: is bad", "mend it", 2)
    with pytest.raises(SawbenchError, match="is bad"):
        rows["b"].checked()
    assert run(tmp_path, pieces, retries=True)[1] == ["b"]


def test_what_was_half_written_when_the_run_was_broken_off_is_written_anew(tmp_path):
    pieces = pieces_of(tmp_path, {"a": "one", "b": "two"})
    running = Journal(tmp_path).run(written, pieces)
    assert next(running).name == "a"
    running.close()
    (tmp_path / "b").write_text("tw")
    with (tmp_path / JOURNAL).open("a") as file:
        file.write('{"name": "b", "key": "tw')  # the line that was being written when the power went
    assert run(tmp_path, pieces)[1] == ["b"]
    assert (tmp_path / "b").read_text() == "two"
    assert run(tmp_path, pieces)[1] == []


def test_another_source_or_a_result_that_is_gone_is_done_again(tmp_path):
    pieces = pieces_of(tmp_path, {"a": "one", "b": "two"})
    run(tmp_path, pieces)
    (tmp_path / "b").unlink()
    changed = replace(pieces[0], key="ONE", request=(tmp_path / "a", "ONE"))
    assert run(tmp_path, [changed, pieces[1]])[1] == ["a", "b"]
    assert (tmp_path / "a").read_text() == "ONE"


def test_a_file_of_somebody_else_is_not_overwritten(tmp_path):
    (tmp_path / "a").write_text("theirs")
    pieces = pieces_of(tmp_path, {"a": "one"})
    with pytest.raises(InputError, match="exists already"):
        run(tmp_path, pieces)
    assert (tmp_path / "a").read_text() == "theirs"
    run(tmp_path, pieces, overwrites=True)
    assert (tmp_path / "a").read_text() == "one"


def test_two_pieces_of_one_name_are_refused(tmp_path):
    (piece,) = pieces_of(tmp_path, {"a": "one"})
    with pytest.raises(InputError, match="a: is named twice"):
        run(tmp_path, [piece, replace(piece, key="other")])
