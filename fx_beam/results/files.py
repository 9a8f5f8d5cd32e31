"""Files that users ask to be written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fx_beam.validation import shown


def writable(path: Path | str, endings: Sequence[str] = ()) -> Path:
    """The path of a file to be written; ValueError for a missing folder or an unknown ending."""
    if not isinstance(path, str | Path) or not str(path):
        raise ValueError(f"path = {shown(path)} must be the name of a file, or a Path")
    file = Path(path)
    if not file.parent.is_dir():
        raise ValueError(f"cannot write {file}: make the folder {file.parent} first")
    if endings and file.suffix.lower().lstrip(".") not in endings:
        raise ValueError(f"cannot write {file}: its name must end with .{', .'.join(endings)}")
    return file
