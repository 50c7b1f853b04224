"""Tables and campaigns of other programs to recordings: `import_path`."""

from sawbench.storage.importers.column_choice import convert_signal
from sawbench.storage.importers.dispatch import ImportReport, import_path, stem_of
from sawbench.storage.importers.table import FramesNeedDbc
from sawbench.storage.importers.table_map import ColumnRule, TableMap, load_map

__all__ = [
    "ColumnRule",
    "FramesNeedDbc",
    "ImportReport",
    "TableMap",
    "convert_signal",
    "import_path",
    "load_map",
    "stem_of",
]
