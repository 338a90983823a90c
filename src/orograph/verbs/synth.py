"""``orograph.synth``: a fractal terrain, or one synthesised from an example, of any size, in memory, in a file or as a
store."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, overload

from orograph._named import answering
from orograph.dem.header import copyright_tags
from orograph.dem.raster import Dem
from orograph.dem.synth import Synth, parse_size, write_windows
from orograph.dem.target import parse_crs
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.output import check_vacant
from orograph.progress import Progress
from orograph.reporting import reporting

if TYPE_CHECKING:
    from orograph.synthesis.terrain import ByExample

SPACING, CRS, ROUGHNESS = 30.0, "EPSG:32633", 1.0
"""Defaults for a fractal terrain; an exemplar brings its own."""

MEMORY = 1 << 30
"""Bytes of a build, by default."""

STORE = ".oro"
"""The ending of a store's name."""


class Synthesis(TypedDict, total=False):
    """The options of ``synth`` as type checkers and editors know them; a test compares them."""

    size: int | str | tuple[int, int]
    seed: int
    spacing: float | None
    crs: Any
    relief: float | None
    roughness: float | None
    exemplar: Any
    jitter: float | Sequence[float] | None
    passes: float | Sequence[float] | None
    over: Any
    ground: Any
    compress: str
    overwrite: bool
    resume: bool
    jobs: int | None
    max_memory: Amount
    workers: int | None
    dask: Any
    part: str | tuple[int, int] | None
    finish: bool
    progress: Progress | bool | None


@overload
def synth(output: None = None, **options: Unpack[Synthesis]) -> Dem: ...


@overload
def synth(output: str | os.PathLike[str], **options: Unpack[Synthesis]) -> Path: ...


@overload
def synth(output: str | os.PathLike[str] | None, **options: Unpack[Synthesis]) -> Dem | Path: ...


@answering
def synth(
    output: str | os.PathLike[str] | None = None,
    *,
    size: int | str | tuple[int, int] = 1025,
    seed: int = 1,
    spacing: float | None = None,
    crs: Any = None,
    relief: float | None = None,
    roughness: float | None = None,
    exemplar: Any = None,
    jitter: float | Sequence[float] | None = None,
    passes: float | Sequence[float] | None = None,
    over: Any = None,
    ground: Any = None,
    compress: str = "zstd",
    overwrite: bool = False,
    resume: bool = False,
    jobs: int | None = None,
    max_memory: Amount = MEMORY,
    workers: int | None = None,
    dask: Any = None,
    part: str | tuple[int, int] | None = None,
    finish: bool = False,
    progress: Progress | bool | None = None,
) -> Dem | Path:
    """Make a fractal terrain: plains, and ranges carved by rivers; or a terrain that resembles an example; or colours.

    The same seed and size give the same heights.

    Args:
        output: the GeoTIFF to write, or the store to build if it ends in ``.oro``, in blocks, so that any size works;
            None: the terrain is returned.
        size: samples per side, or (rows, columns). seed: each number gives another terrain.
        spacing: metres between samples; None: 30. crs: a projected CRS; None: EPSG:32633, or the example's.
        relief: metres from the lowest to the highest place; None: 6 % of the side, at most 2500.
        roughness: depth of the finer furrows: 0 smooth, 1 natural, which is the default.
        exemplar: a terrain to imitate (Lefebvre & Hoppe 2005): whatever ``orograph.terrain`` takes, of at most 4
            million samples, none missing. It determines the spacing, the relief and the roughness.
        jitter: with an exemplar, how much its pieces vary, 0 to 1; one number, or one for each level from the coarsest
            on. None: 0.5, and 0 on the three finest.
        passes: with an exemplar, how often places are corrected, 0 to 2; also one number or one per level. None: 2, and
        0 on the two finest.
        over: a terrain to make colours for, whatever ``orograph.terrain`` takes: then ``exemplar`` is a photo, and the
            file an image, a layer for pictures (``layers=``).
        ground: with ``over``, the heights of what the photo shows.
        compress: of the file: "zstd", "deflate" or "none". overwrite: replace an existing file or store.
        resume: finish an interrupted store that was begun with the same arguments, to the same bytes; starts one if
            there is none.
        jobs: threads; None: all processors.
        max_memory, workers, dask, part, finish: how a store is built, as of ``orograph.build``.
        progress: gets progress reports; False: silent.

    Returns:
        a ``Dem``, or the path of the file or store.

    Raises:
        UsageError: an option makes no sense, or the exemplar is unsuitable.
        ReadError: the exemplar cannot be read. OutputError: the file cannot be written, or exists.
        StoreError: the store cannot be written, or the interrupted store was begun with other arguments.
    """
    path, max_memory = None if output is None else Path(output), bytes_of(max_memory)
    how = {"workers": workers, "dask": dask, "part": part, "finish": finish}
    check_output(path, overwrite, resume, how)
    heard = reporting(progress)
    if over is not None or ground is not None:
        said = {"spacing": spacing, "crs": crs, "relief": relief, "roughness": roughness, "jitter": jitter,
                "passes": passes}  # fmt: skip
        return colours(over, exemplar, ground, path, seed, said, compress=compress, jobs=jobs, progress=heard)
    made = maker(size, seed, spacing, crs, relief, roughness, exemplar, jitter, jobs, heard, passes=passes)
    if path is not None:
        write(
            made, path, compress=compress, overwrite=overwrite, resume=resume, jobs=jobs, max_memory=max_memory,
            progress=heard, **how,
        )  # fmt: skip
        return path
    rows, cols = made.grid.shape
    if isinstance(made, Synth):
        made.prepare(heard)
    return Dem(made.read(0, rows, 0, cols), made.grid, None, made.name, tuple(getattr(made, "attribution", ())))


def check_output(path: Path | None, overwrite: bool, resume: bool, how: Mapping[str, Any]) -> None:
    """Raise an error if the output is there already, or is no store but is to be resumed, or made by several processes.

    Args:
        how: ``workers``, ``dask``, ``part`` and ``finish``.

    Raises:
        UsageError, OutputError: see above.
    """
    several = [name for name, value in how.items() if value]
    store = path is not None and path.suffix.lower() == STORE
    if resume and not store:
        raise UsageError(
            "Only a store can be resumed: a file is either complete or absent.", path=path,
            remedy=f"Leave out `resume`, or write a store ({STORE}).",
        )  # fmt: skip
    if several and not store:
        raise UsageError(
            f"Only a store is made by several processes (`{several[0]}`); a file is written by one.", path=path,
            remedy=f"Leave out `{several[0]}`, or write a store ({STORE}).",
        )  # fmt: skip
    if path is not None and not (resume or how["part"] or how["finish"]):
        check_vacant(path, overwrite)


def maker(
    size: int | str | tuple[int, int], seed: int, spacing: float | None, crs: Any, relief: float | None,
    roughness: float | None, exemplar: Any, jitter: float | Sequence[float] | None, jobs: int | None,
    progress: Progress, *, passes: float | Sequence[float] | None = None,
) -> Synth | ByExample:  # fmt: skip
    """The generator of the terrain that these arguments of ``synth`` describe.

    Raises: as ``synth``.
    """
    shape = tuple(size) if isinstance(size, tuple | list) else parse_size(str(size))
    if len(shape) != 2 or min(shape) < 2:
        raise UsageError(f"The size must be a number of samples, or (rows, columns), not {size!r}.")
    rows, cols = int(shape[0]), int(shape[1])
    if exemplar is None:
        for name, value in (("jitter", jitter), ("passes", passes)):
            if value is not None:
                raise UsageError(f"{name} only apply to an exemplar.", remedy="Give an `exemplar` too.")
        return Synth(
            (rows, cols), seed, spacing=SPACING if spacing is None else spacing, crs=parse_crs(crs or CRS),
            relief=relief, roughness=ROUGHNESS if roughness is None else roughness,
        )  # fmt: skip
    given = {"spacing": spacing, "relief": relief, "roughness": roughness}
    if said := [name for name, value in given.items() if value is not None]:
        raise UsageError(
            f"The exemplar determines the {' and the '.join(said)}.", remedy=f"Leave out the {' and the '.join(said)}."
        )
    from orograph.synthesis.terrain import ByExample

    projected = None if crs is None else parse_crs(crs)
    return ByExample(
        exemplar, (rows, cols), seed, crs=projected, jitter=jitter, passes=passes, jobs=jobs, progress=progress
    )


def colours(
    over: Any, photo: Any, ground: Any, path: Path | None, seed: int, said: Mapping[str, Any], *, compress: str,
    jobs: int | None, progress: Progress,
) -> Path:  # fmt: skip
    """Synthesise colours for a terrain from an example.

    Args:
        said: the arguments of ``synth`` that do not apply to colours.

    Raises: as ``synth``.
    """
    from orograph.dem.synth import write_windows
    from orograph.synthesis.colours import ColoursByExample

    if wrong := [name for name, value in said.items() if value is not None]:
        raise UsageError(f"Colours have no {' and no '.join(wrong)}.", remedy="Leave it out.")
    if over is None or photo is None or ground is None or path is None or path.suffix.lower() not in (".tif", ".tiff"):
        raise UsageError(
            "Colours by example need a photo (`exemplar`), the heights of what it shows (`ground`), the terrain to "
            "colour (`over`), and a GeoTIFF to write."
        )
    made = ColoursByExample(photo, ground, over, seed, jobs=jobs, progress=progress)
    tags = copyright_tags(made.attribution)
    write_windows(made, path, compress=compress, jobs=jobs, progress=progress, tags=tags)
    return path


def write(
    made: Synth | ByExample, path: Path, *, compress: str, overwrite: bool, resume: bool, jobs: int | None,
    progress: Progress, **how: Any,
) -> None:  # fmt: skip
    """Write a terrain as a GeoTIFF, or build a store of it (``.oro``).

    Args:
        how: the store is built: ``max_memory``, ``workers``, ``dask``, ``part``, ``finish``.

    Raises:
        OutputError, StoreError: it cannot be written.
    """
    if path.suffix.lower() == STORE:
        from orograph.store.build import build

        if isinstance(made, Synth):
            made.prepare(progress)
        built = build(made, path, overwrite=overwrite, resume=resume, jobs=jobs, progress=progress, **how)
        if built is not None:
            built.close()
    elif isinstance(made, Synth):
        made.write(path, compress=compress, jobs=jobs, progress=progress)
    else:
        write_windows(made, path, compress=compress, jobs=jobs, progress=progress, tags=made.tags)
