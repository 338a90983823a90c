"""The ground of a frame: what is selected of it, and the surface that draws such a selection.

A *surface* draws one kind of selection into depth and marks. The terrain's own patches are streamed and drawn as
instances with heights from the atlas (``patches``). Another method's selection is drawn by the surface of its kind
(``rays`` for windows that rays are cast at), or as triangles (``meshes``). For a method that lives on the GPU nothing
is selected: its tree is updated and drawn (``growing``, ``tree``). Batches of small meshes stay there (``batches``),
compressed chunks are decoded there first (``chunks``), pieces of patches are instances (``pieces``), and heights of a
clipmap's rings lie in toroidal textures (``clipmap``). All later passes (light, lines, voids) read the targets
only. A new kind of selection gets its surface by a line in ``Ground.surfaces``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from orograph.errors import UsageError
from orograph.gpu.device import Device
from orograph.lod.patches.shape import INSTANCE, patch_indices, patch_vertices
from orograph.lod.registry import Choice
from orograph.lod.selection import (
    ClipRings,
    CodedChunks,
    PatchesAndRays,
    PieceSet,
    RayWindows,
    Selection,
    TinBatches,
    TriangleMesh,
)
from orograph.lod.triangle_patches import Patches
from orograph.rendering.gpu.stream.residency import Chosen, Residency
from orograph.rendering.gpu.stream.tiles import missing
from orograph.rendering.gpu.surface.batches import Batches, BatchPass
from orograph.rendering.gpu.surface.chunks import ChunkPass, Chunks, DecodedChunks
from orograph.rendering.gpu.surface.clipmap import ClipPass, HeldRings, ready_of
from orograph.rendering.gpu.surface.growing import Growing, living
from orograph.rendering.gpu.surface.left import DEPTH_ONLY, Left, Slopes
from orograph.rendering.gpu.surface.meshes import MeshPass, Ready, Selected
from orograph.rendering.gpu.surface.mixed import MixableWindows, Mixed, MixedPass, Mixing
from orograph.rendering.gpu.surface.mixer import Mixer
from orograph.rendering.gpu.surface.patches import PatchPass
from orograph.rendering.gpu.surface.pieces import DrawnPieces, PiecePass, Pieces
from orograph.rendering.gpu.surface.rays import RayPass
from orograph.rendering.gpu.surface.resident import Resident, ResidentMeshes
from orograph.rendering.gpu.surface.tree import TreeFrame, TreePass
from orograph.rendering.gpu.surface.windows import CastWindows, Windows
from orograph.rendering.gpu.targets import Targets
from orograph.scene.methods import mesh_choice
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View


class Surface(Protocol):
    """Draws selections of one kind."""

    def draw(self, encoder: Any, targets: Targets, selection: Any, left: Left) -> None:
        """Clear the targets, draw a selection into depth and marks, and leave what ``left`` asks for."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """What a frame draws.

    Attributes:
        streamed: the terrain's patches, which tell what is in view even if another method's selection is drawn.
        selection: what is drawn. missing: tiles that would improve it.
    """

    streamed: Chosen
    selection: Patches | Selection | Mixed

    @property
    def patches(self) -> Patches:
        """The terrain's own patches."""
        return self.streamed.patches

    @property
    def mesh(self) -> Tessellation | None:
        """The triangles of another method's selection; None: patches are drawn, or rays are cast."""
        return self.selection.mesh if isinstance(self.selection, TriangleMesh) else None

    @property
    def other(self) -> Any:
        """What is drawn instead of patches; a new object whenever it changes; None: patches are drawn."""
        if isinstance(self.selection, Resident):
            return self.selection
        if isinstance(self.selection, TreeFrame):
            return self.selection.tree
        if isinstance(self.selection, Mixed):
            return self.selection.rays
        mesh = self.mesh
        return self.rays if mesh is None else mesh

    @property
    def state(self) -> Any:
        """The same, but a new object after every update of a tree."""
        return self.selection if isinstance(self.selection, TreeFrame) else self.other

    @property
    def resident(self) -> TreeFrame | Resident | None:
        """What is drawn, if only the GPU has its triangles; else None."""
        return self.selection if isinstance(self.selection, (TreeFrame, Resident)) else None

    @property
    def at_breaks(self) -> bool:
        """Whether only pixels where depth breaks off get more than one sample."""
        return isinstance(self.selection, CastWindows) and self.selection.at_breaks

    @property
    def drawn(self) -> int:
        """The number of patches that are drawn."""
        if isinstance(self.selection, Mixed):
            return len(self.selection.instances)
        return len(self.patches.instances) if isinstance(self.selection, Patches) else 0

    @property
    def rays(self) -> CastWindows | None:
        """The windows that rays are cast at; None: no rays are cast."""
        if isinstance(self.selection, Mixed):
            return None if self.selection.rays is None else self.selection.cast.windows
        return self.selection if isinstance(self.selection, CastWindows) else None


class Ground:
    """The ground of one terrain on one device.

    Args:
        camera: the uniform buffer (``camera.CAMERA``).
        tiles: the terrain's. stored_slopes, levels: those of ``shade.resources.Resources``.
        most: bytes for the windows that rays are cast at; a tree's pages get twice as many. jobs: threads.

    Attributes:
        surfaces: the surface for each type of selection. batches: those that stay on the GPU.
    """

    def __init__(
        self, device: Device, terrain: Terrain, camera: Any, tiles: Residency, stored_slopes: tuple[Any, Any, Any],
        levels: Any, most: int, jobs: int | None = None,
    ) -> None:  # fmt: skip
        self.tiles = tiles
        legs, heights, absent = tiles.method.legs, tiles.heights, missing(terrain)
        self._patches = PatchPass(
            device, camera, heights.texture, stored_slopes, patch_vertices(legs), patch_indices(legs),
            INSTANCE.itemsize, absent,
        )  # fmt: skip
        rays = self._rays = RayPass(device, camera)
        mixed = MixedPass(device, self._patches, rays)
        field = heights.texture.create_view(dimension="2d-array"), heights.page_buffer, levels
        self.surfaces: Mapping[type, Surface] = {
            Patches: self._patches,
            TriangleMesh: MeshPass(device, camera, field, absent),
            CastWindows: rays,
            Mixed: mixed,
            TreeFrame: TreePass(device, camera, field, absent, terrain.n),
            DecodedChunks: ChunkPass(device, camera, field, absent),
            ResidentMeshes: BatchPass(device, camera, field, absent),
            HeldRings: ClipPass(device, camera, field, absent),
            DrawnPieces: PiecePass(device, camera, field, absent),
        }
        windows = Windows(device, terrain, most, jobs)
        self._mixer = Mixer(device, terrain, camera, legs, mixed)
        self.batches = Batches(device, most)
        own: dict[type, Any] = {
            RayWindows: self._compiling(windows.ready),
            PatchesAndRays: self._compiling(Mixing(device, terrain, windows).ready),
            CodedChunks: Chunks(device, most).ready, TinBatches: self.batches.ready,
            ClipRings: ready_of(terrain.grid.shape, most),
            PieceSet: Pieces(device, tiles).ready,
        }  # fmt: skip
        self._selected = Selected(terrain, own, self._have)
        self._growing = Growing(device, terrain, 2 * most, jobs)
        self._drawn: Drawn | None = None
        self._sloped = False
        self._known: tuple[Any, tuple[bool, Choice | None]] | None = None

    def choose(self, scene: Scene, freeze: View | None, tolerance: float, *, wait: bool) -> Drawn:
        """Choose what a frame of a scene draws.

        Args:
            freeze: the camera to select for, if not the scene's. tolerance: of patches, pixels.
            wait: until everything is there.

        Raises:
            OrographError: with ``wait``, a tile cannot be read or the method cannot draw the scene.
        """
        view, surface = scene.view, scene.surface
        own, alive = self._kind(scene)
        camera = freeze or surface.mesh_view or view
        chosen = self.tiles.choose(
            camera, tolerance, surface.exaggeration, wait=wait, later=True, drawn=wait or own or self._of_tiles(scene)
        )  # fmt: skip
        if alive is None:
            self._growing.none()
        else:
            (self._growing.at_once if wait else self._growing.aside)(scene, camera, alive, chosen.patches)
        if alive is not None or own:
            self._selected.none()
        elif wait or not self._mixes or self._mixer.look():
            have = self._selected.at_once if wait else self._selected.aside
            have(scene, camera, _of_rays(scene, tolerance))
        found: Any = self._growing.selection or self._selected.selection or chosen.patches
        if isinstance(found, MixableWindows):
            found = self._mixer.mixed(
                chosen.patches, found, view, surface.exaggeration, _of_rays(scene, tolerance), wait=wait
            )
        else:
            self._mixer.forget()
        self._drawn = Drawn(chosen, found)
        return self._drawn

    def _of_tiles(self, scene: Scene) -> bool:
        """Whether the last frame drew patches, at least in part, or the scene's lines are looked up in their tiles."""
        last = None if self._drawn is None else self._drawn.selection
        return last is None or isinstance(last, Patches | Mixed) or scene.annotations.contours is not None

    def _have(self, selection: Selection, wait: bool) -> bool:
        """Have the tiles that a selection is drawn from; whether all are there."""
        return not isinstance(selection, DrawnPieces) or self.tiles.hold(selection.tiles, wait=wait)

    @property
    def _mixes(self) -> bool:
        return isinstance(self._selected.selection, MixableWindows)

    def draw(self, encoder: Any, targets: Targets, drawn: Drawn, left: Left = DEPTH_ONLY) -> None:
        """Clear the targets and draw the ground."""
        self._sloped = bool(left.slopes)
        self.surfaces[type(drawn.selection)].draw(encoder, targets, drawn.selection, left)

    def _compiling(self, ready: Ready) -> Ready:
        """What makes windows ready, in the thread that selects them, and first compiles what casts rays at them."""

        def both(selection: Any, again: Callable[[float], Any]) -> Selection:
            block = selection.block if isinstance(selection, PatchesAndRays) else None
            self._rays.compile(selection.surface, self._sloped, block)
            return ready(selection, again)

        return both

    def find_breaks(self, encoder: Any, targets: Targets, plan: bool) -> None:
        """Find where the hits of rays break off; see ``RayPass``."""
        self._rays.find_breaks(encoder, targets, plan)

    def draw_patches(self, encoder: Any, targets: Targets, patches: Patches) -> None:
        """Clear the targets and draw the terrain's own patches."""
        self._patches.draw(encoder, targets, patches, DEPTH_ONLY)

    def compile(self, edges: bool, slopes: Slopes) -> None:
        """Compile the pipeline for patches."""
        self._patches.pipeline(edges, slopes)

    @property
    def mesh(self) -> Tessellation | None:
        """The triangles of another method's selection in the last frame; None: it drew patches, or rays."""
        return None if self._drawn is None else self._drawn.mesh

    @property
    def resident(self) -> TreeFrame | Resident | None:
        """What the last frame drew, if only the GPU has its triangles; else None."""
        return None if self._drawn is None else self._drawn.resident

    @property
    def rays(self) -> CastWindows | None:
        """The windows that the last frame's rays were cast at; None: it drew triangles."""
        return None if self._drawn is None else self._drawn.rays

    @property
    def growing(self) -> Growing:
        """The tree of a method that lives on the GPU."""
        return self._growing

    @property
    def busy(self) -> bool:
        """Whether another selection is being made."""
        return self._selected.busy or self._growing.busy

    @property
    def failure(self) -> str:
        """What of the ground is unavailable, and why; "" if nothing."""
        return self.tiles.failure or self._selected.failure or self._growing.failure

    def current(self, scene: Scene) -> bool:
        """Whether what is drawn is what the scene asked for; patches always are."""
        own, alive = self._kind(scene)
        return own or (self._selected if alive is None else self._growing).current

    def _kind(self, scene: Scene) -> tuple[bool, Choice | None]:
        """Whether the terrain's own patches are drawn, and the method of a scene if it lives on the GPU; told anew when
        another method is asked for."""
        key = scene.surface.method, scene.surface.triangles
        if self._known is None or self._known[0] != key:
            own = streamed(scene)
            self._known = key, (own, None if own else _living(scene))
        return self._known[1]

    def close(self) -> None:
        """Stop reading and selecting."""
        self.tiles.close()
        self._selected.close()
        self._growing.close()


def _of_rays(scene: Scene, tolerance: float) -> float:
    """The tolerance of rays for one of patches, pixels: in a plan it is the size of samples; lines do not count."""
    if scene.view.projection != "plan":
        return tolerance
    return min(scene.surface.tolerance or 1.0, math.inf if scene.annotations.contours is None else FINE)


FINE = 0.7
"""Pixels between the samples of a plan with contour lines."""


def _living(scene: Scene) -> Choice | None:
    """The method of a scene if it lives on the GPU."""
    try:
        return living(scene)
    except UsageError:  # ``Selected`` reports it
        return None


def streamed(scene: Scene) -> bool:
    """Whether the terrain's own patches are drawn."""
    try:
        return mesh_choice(scene.surface.method, "gpu", scene.surface.triangles) is None
    except UsageError:  # ``Selected`` reports it
        return False
