"""What a frame shows besides its scene, and its statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from orograph.rendering.gpu.surface.ground import Drawn

Normals = Literal["computed", "stored", "sampled", "derivatives", "faces"]
"""The source of the ground's normal in a pixel: see docs/gpu.md."""


@dataclass(frozen=True, slots=True)
class Overlay:
    """What is drawn over the ground to inspect the mesh.

    Attributes:
        wireframe: edges of triangles. levels: a colour for every size of patches; where rays are cast, two shades of
            grey by the level of the window.
        occlusion: strength of ambient occlusion in screen space (``rendering.gpu.shade.ssao``), 0 to 1, 0: none; its
        ``reach``, metres;
            None: a twelfth of the distance to the target.
        normals: "computed" for every pixel from heights, finer than the mesh and prefiltered; "stored" at the vertices
            of patches, "sampled": from heights half a pixel to every side (other methods' meshes show their faces);
            "derivatives": of the position on the screen; "faces": of the triangles drawn (of patches: by
            derivatives, too).
    """

    wireframe: bool = False
    levels: bool = False
    occlusion: float = 0.0
    reach: float | None = None
    normals: Normals = "computed"


PLAIN = Overlay()


@dataclass(frozen=True, slots=True)
class FrameStats:
    """Statistics of a frame.

    Attributes:
        patches, triangles: drawn. error_px: the bound of the largest error on the screen with the tiles present;
            None: the method promises none.
        select_ms: selection. submit_ms: Python time until the frame is submitted, during which the GPU waits. cpu_ms:
            all of the frame's Python time, including work after submission (prefetching), but not the driver's work on
            submission (software drivers do all of it then).
        tiles_loaded, bytes_uploaded: in this frame. tiles_resident, tiles_wanted: of all kinds; wanted: not present
        yet.
        samples: number averaged in the picture.
        failed: a tile that could not be read, or a mesh that could not be made, and why, or "".
        current: whether the mesh of another method belongs to this camera and tolerance; patches always do.
        notes: messages about opened layers, full sentences; each appears once.
        windows: at which rays were cast, in place of triangles; 0: none were cast, or nothing is in view.
        making: progress of layers being prepared in the background, a full sentence, or ""; a later frame shows more.
    """

    patches: int
    triangles: int
    error_px: float | None
    select_ms: float
    cpu_ms: float
    tiles_loaded: int
    bytes_uploaded: int
    tiles_resident: int
    tiles_wanted: int
    samples: int
    failed: str = ""
    notes: tuple[str, ...] = ()
    current: bool = True
    submit_ms: float = 0.0
    making: str = ""
    windows: int = 0


@dataclass(frozen=True, slots=True)
class FrameChoice:
    """What a frame draws.

    Attributes:
        ground: its selection. tolerance: used to choose patches, pixels. layers: on the ground.
        lettered: whether contours are labelled. loaded: tiles loaded for it, and their ``bytes``.
        state: frames of one camera are the same picture while it is unchanged.
    """

    ground: Drawn
    tolerance: float
    layers: Any
    lettered: bool
    loaded: int
    bytes: int
    state: tuple[Any, ...]
