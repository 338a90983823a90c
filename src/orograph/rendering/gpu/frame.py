"""What a frame shows besides its scene, and what it took."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from orograph.rendering.gpu.surface.ground import Drawn

Normals = Literal["computed", "stored", "sampled", "derivatives", "faces"]
"""Where the normal of the ground in a pixel comes from: see docs/gpu.md."""


@dataclass(frozen=True, slots=True)
class Overlay:
    """What is drawn over the ground to look at the mesh.

    Attributes:
        wireframe: edges of triangles. levels: a colour for every size of patches; grey where rays are
            cast, of two shades by the level of the window.
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
    """What a frame took.

    Attributes:
        patches, triangles: drawn. error_px: the bound of the largest error on the screen with the tiles there are.
        select_ms: selection. submit_ms: Python until the frame is handed over, for which the GPU waits. cpu_ms: all of
            the frame's Python, with what is done after that (looking ahead), but for what the driver does when it is
            given the work (software drivers do all of it then).
        tiles_loaded, bytes_uploaded: in this frame. tiles_resident, tiles_wanted: of all kinds; wanted: not there yet.
        samples: how many are averaged in the picture.
        failed: a tile that could not be read, or a mesh that could not be made, and why, or "".
        current: whether the mesh of another method is that of this camera and tolerance; patches always are.
        notes: what a user should know of layers that were opened, full sentences; each is told once.
        windows: at which rays were cast, in place of triangles; 0: none were, or nothing is in view.
        making: what is made aside of layers, and how far it is, a full sentence, or "": a later frame shows more.
    """

    patches: int
    triangles: int
    error_px: float
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
        ground: what of it. tolerance: that patches were chosen by, pixels. layers: on the ground.
        lettered: whether contours are labelled. loaded: tiles that came for it, of so many ``bytes``.
        state: two frames of one camera are one picture while it is the same.
    """

    ground: Drawn
    tolerance: float
    layers: Any
    lettered: bool
    loaded: int
    bytes: int
    state: tuple[Any, ...]
