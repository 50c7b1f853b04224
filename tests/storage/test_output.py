"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from sawbench.acquisition.calibration_fit import write_points
from sawbench.bench.errors import InputError, RecordingError
from sawbench.storage.output import PartFile, write_whole

pytestmark = pytest.mark.unit


def test_what_is_there_stays_unless_it_may_be_replaced(tmp_path):
    path = tmp_path / "a.csv"
    assert write_whole(path, "first\n") == path
    with pytest.raises(InputError, match=r"a\.csv: already exists"):
        write_whole(path, "second\n")
    assert path.read_bytes() == b"first\n"
    write_whole(path, b"second\r\n", overwrite=True)
    assert path.read_bytes() == b"second\r\n"


def test_a_write_that_fails_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    path.write_text("old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("sawbench.storage.output.os.fsync", full)
    with pytest.raises(OSError, match=r"No space left on device.*a\.json"):
        write_whole(path, "new", overwrite=True)
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_is_made_only_where_that_is_asked(tmp_path):
    path = tmp_path / "new" / "a.csv"
    with pytest.raises(InputError, match="cannot be written: No such file or directory"):
        write_whole(path, "x")
    assert not path.parent.exists()
    assert write_whole(path, "x", makes_folder=True).read_text() == "x"


def test_a_link_stays_and_its_target_is_replaced_with_its_permissions(tmp_path):
    target, link = tmp_path / "kept.toml", tmp_path / "link.toml"
    target.write_text("old")
    target.chmod(0o600)
    link.symlink_to(target.name)
    write_whole(link, "new", overwrite=True)
    assert link.is_symlink() and target.read_text() == "new" and target.stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_whole(pipe, "through", overwrite=True)
        assert os.read(end, 100) == b"through" and pipe.is_fifo()
    finally:
        os.close(end)
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        write_whole(tmp_path, "x", overwrite=True)


def test_a_file_name_that_is_no_utf8_does_not_lose_the_page(tmp_path):
    path = tmp_path / "a.html"
    write_whole(path, os.fsdecode(b"oak-\xff.mcap"))
    assert path.read_bytes() == b"oak-\\udcff.mcap"


def test_a_folder_that_is_a_file_is_no_interrupted_recording(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match=r"o\.mcap\.part: cannot be written: Not a directory"):
        PartFile(tmp_path / "file" / "o.mcap", overwrite=False)


def test_points_are_not_written_over_others(tmp_path: Path):
    path = tmp_path / "points.csv"
    path.write_text("precious")
    with pytest.raises(InputError, match="already exists"):
        write_points(path, [])
    assert path.read_text() == "precious"
