"""Frames into a file: H.264 (.mp4, .mov, .mkv), VP9 (.webm), an animated .gif, or pictures (frames/%05d.png).

Video is yuv420p, with limited range and the matrix, primaries and transfer of ITU-R BT.709, converted and tagged so:
players that use the tags, and those that guess from the size, show the correct colours. FFmpeg does the work, by
way of PyAV (``pip install 'orograph[movie]'``); pictures need nothing. A film appears whole or not at all; pictures one
by one, each complete, so that a film of pictures can be resumed.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError, UsageError
from orograph.output import Beside, check_folder, remove

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

Pixels = NDArray[np.uint8]

CODECS = {
    ".mp4": ("libx264", "mp4"), ".mov": ("libx264", "mov"), ".mkv": ("libx264", "matroska"),
    ".webm": ("libvpx-vp9", "webm"), ".gif": ("gif", "gif"),
}  # fmt: skip
"""Endings of video files: FFmpeg's names of the codec and of the format."""

GIF_FPS = 100
"""Its delays are whole hundredths of a second (GIF89a, section 23)."""

QUALITY = {"libx264": 18, "libvpx-vp9": 28}
"""Constant rate factors without visible loss: see ``--crf``."""

BT709 = 1
"""ITU-T H.273: the code of BT.709 for primaries, transfer characteristics and matrix alike."""

LIMITED = 1
"""FFmpeg's AVCOL_RANGE_MPEG: luma from 16 to 235."""

NUMBERED = re.compile(r"%0?(\d*)d")


class Writer(Protocol):
    """Where frames go; a context manager. An error leaves nothing behind."""

    def add(self, number: int, pixels: Pixels) -> None:
        """The next frame: (height, width, 3) uint8, sRGB."""

    def has(self, number: int) -> bool:
        """Whether this frame already exists and need not be drawn."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def is_numbered(path: str | Path) -> bool:
    """Whether a path stands for one picture per frame."""
    return NUMBERED.search(Path(path).name) is not None


def check_movie(path: str | Path, size: tuple[int, int] | None, crf: int | None) -> None:
    """Raise UsageError if such a movie cannot be written, before any work; OutputError if there is no folder."""
    out = Path(path)
    if is_numbered(out):
        from orograph.rendering.picture import picture_format

        picture_format(out)
        try:
            out.name % 0
        except (TypeError, ValueError) as error:
            raise UsageError(
                "The name of the frames must contain one number, such as %05d.",
                path=out,
                remedy="Write %% for a literal %.",
            ) from error
        if crf is not None:
            raise UsageError("`crf` applies to video only, not to pictures.")
        return
    suffix = out.suffix.lower()
    if suffix not in CODECS:
        raise UsageError(
            f"Movies cannot be written as {out.suffix or 'a file without ending'}.", path=out,
            remedy="Use .mp4, .webm, .gif, or frames/%05d.png for pictures.",
        )  # fmt: skip
    if crf is not None and suffix == ".gif":
        raise UsageError("`crf` applies to video only, not to a .gif.")
    check_folder(out)
    codec = CODECS[suffix][0]
    if size is not None and codec != "gif" and (size[0] % 2 or size[1] % 2):
        w, h = (v + v % 2 for v in size)
        raise UsageError(
            f"Video needs even numbers of pixels, which {size[0]} × {size[1]} is not.", path=out,
            remedy=f"Use `size={(w, h)}`.",
        )  # fmt: skip
    _av()
    try:
        import av

        av.codec.Codec(codec, "w")
    except Exception as error:
        raise UsageError(
            f"This build of FFmpeg cannot write {suffix} ({codec} is missing).",
            remedy="Use another format, or frames/%05d.png for pictures.",
        ) from error


def _av() -> Any:
    """PyAV.

    Raises:
        UsageError: it is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise UsageError(
            "Writing video needs PyAV, which is not installed.",
            remedy="Install it (pip install 'orograph[movie]'), or write pictures: -o frames/%05d.png.",
        ) from error
    return av


class Video:
    """One video file.

    Args:
        path: ends in one of ``CODECS``. size: (width, height). fps: frames per second.
        crf: constant rate factor, lower is better; None: ``QUALITY``.
        jobs: threads of the encoder; None: its default.
        attribution: the credits in the file's metadata (a .gif has none).
    """

    def __init__(
        self, path: str | Path, size: tuple[int, int], fps: float, *, crf: int | None = None, jobs: int | None = None,
        attribution: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.attribution = attribution
        self.path, self.size, self.fps = Path(path), size, Fraction(fps).limit_denominator(1001)
        self.codec, self.format = CODECS[self.path.suffix.lower()]
        if self.codec == "gif" and fps > GIF_FPS:
            raise UsageError(
                f"A .gif can have at most {GIF_FPS} frames a second, not {fps:g}.",
                remedy="Give fewer, or make an .mp4.",
            )
        self.crf, self.jobs = QUALITY.get(self.codec) if crf is None else crf, jobs
        self.beside = Beside(self.path)
        self.count = 0

    def has(self, number: int) -> bool:
        return False

    def __enter__(self) -> Self:
        av = _av()
        part = self.beside.__enter__()
        options = {"movflags": "+faststart"} if self.format in ("mp4", "mov") else {}
        try:
            self.file: Any = av.open(str(part), "w", format=self.format, options=options)
        except OSError as error:
            raise OutputError(f"The movie cannot be written: {error}.", path=self.path) from error
        if self.attribution:
            self.file.metadata["copyright"] = "; ".join(self.attribution)
        stream: Any = self.file.add_stream(self.codec, rate=self.fps)
        stream.width, stream.height = self.size
        context = stream.codec_context
        if self.jobs is not None:
            context.thread_count = self.jobs
        if self.codec == "gif":
            stream.pix_fmt = "pal8"
            self.graph = self._palettes()
        else:
            stream.pix_fmt = "yuv420p"
            context.colorspace = context.color_primaries = context.color_trc = BT709
            context.color_range = LIMITED
            stream.options = {"crf": str(self.crf)}
            if self.codec == "libvpx-vp9":
                stream.options |= {"b:v": "0", "row-mt": "1", "cpu-used": "3"}
                context.bit_rate = 0
            else:
                stream.options |= {"preset": "medium"}
        self.stream = stream
        return self

    def _palettes(self) -> Any:
        """A filter that gives each frame its own 256 colours."""
        av = _av()
        graph = av.filter.Graph()
        source = graph.add_buffer(
            width=self.size[0], height=self.size[1], format=av.VideoFormat("rgb24"), time_base=1 / self.fps
        )
        split, make = graph.add("split"), graph.add("palettegen", "stats_mode=single")
        use, sink = graph.add("paletteuse", "new=1:dither=sierra2_4a"), graph.add("buffersink")
        source.link_to(split)
        split.link_to(use, 0, 0)
        split.link_to(make, 1, 0)
        make.link_to(use, 0, 1)
        use.link_to(sink)
        graph.configure()
        return graph

    def add(self, number: int, pixels: Pixels) -> None:
        av = _av()
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
        frame.pts, frame.time_base = self.count, 1 / self.fps
        self.count += 1
        if self.codec == "gif":
            self.graph.push(frame)
            self._put(self._pulled())
            return
        yuv: VideoFrame = frame.reformat(
            format="yuv420p", dst_colorspace="ITU709", src_color_range="JPEG", dst_color_range="MPEG",
            interpolation="AREA", dst_color_trc=BT709, dst_color_primaries=BT709,
        )  # fmt: skip
        yuv.pts, yuv.time_base = frame.pts, frame.time_base
        self._put([yuv])

    def _pulled(self) -> list[Any]:
        av = _av()
        found = []
        while True:
            try:
                found.append(self.graph.pull())
            except (av.error.BlockingIOError, av.error.EOFError):
                return found

    def _put(self, frames: list[Any]) -> None:
        for frame in frames:
            for packet in self.stream.encode(frame):
                self.file.mux(packet)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                if self.codec == "gif":
                    self.graph.push(None)
                    self._put(self._pulled())
                for packet in self.stream.encode(None):
                    self.file.mux(packet)
            self.file.close()
        except BaseException as failed:
            self.beside.__exit__(type(failed), failed, None)
            raise
        self.beside.__exit__(kind, error, trace)


class Pictures:
    """One picture per frame; existing frames are kept.

    A hidden file beside them identifies the film.

    Args:
        path: with a number in its name, such as frames/%05d.png; its folder is made.
        fingerprint: of the film (``Film.fingerprint``): frames of another are never mixed with these.
        overwrite: draw all frames again. attribution: the credits in the files' metadata.
        dpi: dots per inch in their metadata; None: none.
    """

    def __init__(
        self, path: str | Path, fingerprint: str, overwrite: bool = False, attribution: Sequence[str] = (),
        dpi: float | None = None,
    ) -> None:  # fmt: skip
        self.attribution, self.dpi = tuple(attribution), dpi
        self.path, self.fingerprint, self.overwrite = Path(path), fingerprint, overwrite
        self.sign = self.path.with_name(f".{NUMBERED.sub('N', self.path.name)}.film")
        self.made: list[Path] = []

    def of(self, number: int) -> Path:
        """The path of a frame."""
        return self.path.with_name(self.path.name % number)

    def has(self, number: int) -> bool:
        return not self.overwrite and self.of(number).is_file()

    def __enter__(self) -> Self:
        folder = self.path.parent
        self.made = [at for at in (folder, *folder.parents) if not at.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            known = self.sign.read_text(encoding="ascii").strip() if self.sign.is_file() else None
            others = known is None and any(self._frames())
            if not self.overwrite and (others or known not in (None, self.fingerprint)):
                raise UsageError(
                    "This folder holds frames of another film (or of another size, light, …).", path=folder,
                    remedy="Choose another folder, or replace them with `overwrite=True`.",
                )  # fmt: skip
            with Beside(self.sign) as part:
                part.write_text(self.fingerprint + "\n", encoding="ascii")
        except OSError as error:
            self._tidy()
            raise OutputError(f"The frames cannot be written: {error.strerror}.", path=folder) from error
        except OutputError:
            self._tidy()
            raise
        return self

    def _tidy(self) -> None:
        """Remove the film's marker and the folders made for it if there is no frame, and so nothing to resume."""
        with contextlib.suppress(OSError):
            if not self._frames():
                remove(self.sign)
                for folder in self.made:
                    folder.rmdir()

    def _frames(self) -> list[Path]:
        """The existing frames, of this film or another."""
        before, after = NUMBERED.split(self.path.name)[0], NUMBERED.split(self.path.name)[-1]
        pattern = re.compile(re.escape(before % ()) + r"\d+" + re.escape(after % ()))
        return [f for f in self.path.parent.iterdir() if pattern.fullmatch(f.name)]

    def add(self, number: int, pixels: Pixels) -> None:
        from orograph.rendering.picture import save_pixels

        save_pixels(pixels, self.of(number), self.attribution, self.dpi)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tidy()
