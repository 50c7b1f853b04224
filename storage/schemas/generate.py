"""Regenerate the `_pb2` modules from the `.proto` files; needs grpcio-tools.

Run `python -m sawbench.storage.schemas.generate` in the root of the repository after a change of a `.proto` file.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROTO_FILES = tuple(sorted(Path(__file__).parent.glob("*.proto")))


def generate(out_dir: Path) -> None:
    """Write `storage/schemas/*_pb2.py` and `.pyi` below `out_dir`.

    Raises
    ------
    RuntimeError
        If protoc does not accept a file; what it says is on stderr.
    """
    from grpc_tools import protoc  # pyright: ignore[reportMissingImports] - needed for this file alone

    well_known = Path(protoc.__file__).parent / "_proto"
    arguments = ["protoc", f"-I{ROOT}", f"-I{well_known}", f"--python_out={out_dir}", f"--pyi_out={out_dir}"]
    status = protoc.main([*arguments, *(str(path.relative_to(ROOT)) for path in PROTO_FILES)])
    if status != 0:
        raise RuntimeError(f"protoc ended with status {status}")
    for stub in out_dir.glob("storage/schemas/*_pb2.pyi"):
        stub.write_text("# ruff: noqa\n# fmt: off\n" + stub.read_text())


if __name__ == "__main__":
    generate(ROOT)
    sys.stdout.write(f"wrote {len(PROTO_FILES)} modules\n")
