"""Whether a verb may write its outputs: checked before any work, so that no result replaces its own input.

Paths are compared as the file system sees them (including links, ``..`` and the case of letters), so another spelling
of an input is still that input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from orograph.errors import UsageError
from orograph.output import same_file

TIFF = (".tif", ".tiff")


def check_outputs(outputs: Mapping[str, str | None], inputs: Mapping[str, Sequence[str | None]]) -> None:
    """Raise UsageError if an output would replace an input, lie in a store that is read, or be the same as another
    output.

    Args:
        outputs: the option's name → its path, or None.
        inputs: what the files are to the user ("the input", "--drape") → their paths, or None.
    """
    written = [(option, path) for option, path in outputs.items() if path is not None]
    for i, (option, path) in enumerate(written):
        for what, files in inputs.items():
            for file in filter(None, files):
                if same_file(path, file):
                    raise UsageError(
                        f"{option} would overwrite {what}.", path=path, remedy="Choose another place to write to."
                    )
                if Path(file).is_dir() and Path(file).resolve() in Path(path).resolve().parents:
                    _check_within(option, path, what, file)
        for other, another in written[:i]:
            if same_file(path, another):
                raise UsageError(
                    f"{other} and {option} are the same file.", path=path, remedy="Give them different names."
                )


def _check_within(option: str, path: str, what: str, folder: str) -> None:
    """Raise UsageError if an output in a folder that is read would damage a store, or be read the next time."""
    from orograph.dem.folders import RASTERS, is_folder

    if not is_folder(folder):
        damage = "which would damage it"
    elif Path(path).suffix.lower() in RASTERS:
        damage = "which would take it for one of its rasters the next time"
    else:
        return
    raise UsageError(
        f"{option} lies within {what} {folder}, {damage}.", path=path, remedy="Choose another place to write to."
    )


def check_ending(option: str, path: str, endings: Sequence[str] = TIFF) -> None:
    """Raise UsageError unless the path has one of the endings."""
    suffix = Path(path).suffix
    if suffix.lower() not in endings:
        raise UsageError(
            f"{option} is a GeoTIFF, which cannot be written as {suffix or 'a file without ending'}.",
            path=path,
            remedy=f"Use {endings[0]}.",
        )
