"""Tables and campaigns of other programs to recordings: `import_path`."""

from storage.importers.dispatch import ImportReport, import_path
from storage.importers.table import FramesNeedDbc

__all__ = ["FramesNeedDbc", "ImportReport", "import_path"]
