"""Time and memory of the last frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imgui_bundle import imgui

if TYPE_CHECKING:
    from orograph.viewer.window import Window


def rows(window: Window) -> list[tuple[str, str]]:
    """(name, value) of what is known about the last frame."""
    stats = window.drawing.stats

    def get(name: str) -> Any:
        return getattr(stats, name, None)

    found = [("between frames", f"{window.interval * 1e3:.1f} ms")]
    for name, what, pattern in (
        ("cpu_ms", "Python", "{:.1f} ms"), ("triangles", "triangles", "{:,}"),
        ("patches", "patches", "{:,}"), ("tiles_resident", "tiles held", "{:,}"),
        ("tiles_wanted", "tiles wanted", "{:,}"), ("tiles_loaded", "tiles loaded", "{:,}"),
        ("error_px", "error", "{:.2f} px"),
    ):  # fmt: skip
        value = get(name)
        if value is not None:
            found.append((what, pattern.format(value).replace(",", " ")))
    found += _mesh(window)
    uploaded = get("bytes_uploaded")
    if uploaded is not None:
        found.append(("uploaded", f"{uploaded / 1e6:.1f} MB"))
    width, height = window.session.view.width, window.session.view.height
    draft = window.drawing.draft
    found.append(("picture", f"{width} × {height}" + (f", {draft.scale:g} in motion" if draft.step else "")))
    found.append(("device", window.device.adapter.name))
    return found


def _mesh(window: Window) -> list[tuple[str, str]]:
    """Statistics of a mesh from another method: its time, and the change from the previous one."""
    tree = getattr(window.drawing.renderer, "tree", None)
    if tree is not None:
        return [(tree.method, "at rest" if window.drawing.stats.current else f"update {tree.stats['updates']}")]
    mesh = getattr(window.drawing.renderer, "mesh", None)
    if mesh is None:
        return []
    stats = mesh.stats
    found = [(str(stats["method"]), f"{stats['refine_ms']:.1f} ms")]
    if "splits" in stats and "merges" in stats:
        counts = (f"{stats[name]:,}".replace(",", " ") for name in ("splits", "merges"))
        found.append(("split, merged", ", ".join(counts)))
    if "changed" in stats and len(mesh.triangles):
        found.append(("new triangles", f"{stats['changed'] / len(mesh.triangles):.2%}"))
    if not getattr(window.drawing.stats, "current", True):
        found.append(("mesh", "is being refined"))
    return found


def draw(window: Window) -> None:
    """Draw the panel."""
    if imgui.begin_table("statistics", 2, imgui.TableFlags_.sizing_stretch_prop):
        imgui.table_setup_column("name", imgui.TableColumnFlags_.width_fixed)
        imgui.table_setup_column("value", imgui.TableColumnFlags_.width_stretch)
        for name, value in rows(window):
            imgui.table_next_column()
            imgui.text_disabled(name)
            imgui.table_next_column()
            imgui.text(value)
        imgui.end_table()
