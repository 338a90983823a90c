"""``orograph.doctor``: what this machine offers for drawing and computing, what is missing, and what to install."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import sys
import time
from collections.abc import Mapping
from typing import Any

EXTRAS = {
    "gpu": ("wgpu",),
    "view": ("rendercanvas", "glfw", "imgui-bundle"),
    "notebook": ("anywidget", "simplejpeg"),
    "movie": ("av",),
    "mesh": ("trimesh",),
    "sample": ("matplotlib",),
    "xarray": ("xarray", "rioxarray", "zarr"),
    "remote": ("obstore",),
}
"""Optional groups of libraries and what they bring."""

USES = {
    "gpu": "`orograph.render(..., backend='gpu')`",
    "view": "the window",
    "notebook": "the window in a notebook",
    "movie": "movie files",
    "mesh": "GLB meshes",
    "sample": "the built-in sample, plots",
    "xarray": "xarray in and out",
    "remote": "stores on the web and in buckets",
}


class Facts(dict[str, Any]):
    """Facts by name; prints as text for people."""

    def __repr__(self) -> str:
        return describe(self)


def describe(facts: Mapping[str, Any]) -> str:
    """The facts as text for people."""
    told: list[str] = []
    told.append(f"Orograph {facts['orograph']} on Python {facts['python']}, {facts['system']}")
    told.append(f"  {facts['processors']} processors, {facts['memory_gib']} GiB of memory")
    told.append("GPU")
    for a in facts["adapters"]:
        idle = "not used: wgpu's OpenGL computes wrongly" if a["backend"] == "OpenGL" else "usable"
        use = "used" if a["used"] else idle
        told.append(f"  {a['name']} ({a['backend']}, {a['kind']}, {a['driver']}): {use}")
    told.append(f"  {facts['gpu']}")
    told.append("Libraries")
    for name, extra in facts["extras"].items():
        have = ", ".join(f"{k} {v or '(missing)'}" for k, v in extra["libraries"].items())
        told.append(f"  {name}: {have}")
        if extra["install"]:
            told.append(f"    for {extra['for']}: {extra['install']}")
    if facts["numcodecs"]:
        told.append(f"  {facts['numcodecs']}")
    told.append(f"Screen\n  {facts['screen']}")
    told.append(f"Kept stores\n  {facts['cache']} ({facts['cache_free_gib']} GiB free)")
    told.append(
        f"  {facts['cache_used_gib']:g} GiB of at most {facts['cache_limit_gib']:g} GiB (OROGRAPH_CACHE_SIZE); "
        "what was used longest ago goes first"
    )
    return "\n".join(told)


def doctor() -> Facts:
    """What this machine offers for drawing and computing, and what to install; fit for JSON."""
    from orograph.folders import cache_folder, cache_limit
    from orograph.parallel import cpu_count
    from orograph.store.kept import entries

    folder = cache_folder()
    place = folder
    while not place.exists():
        place = place.parent
    facts = Facts(
        {
            "orograph": importlib.metadata.version("orograph"),
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "processors": cpu_count(),
            "memory_gib": _memory(),
            "extras": {name: _extra(name, libraries) for name, libraries in EXTRAS.items()},
            "numcodecs": _numcodecs(),
            "screen": _screen(),
            "cache": str(folder),
            "cache_free_gib": round(shutil.disk_usage(place).free / 2**30, 1),
            "cache_used_gib": round(sum(entry.size for entry in entries()) / 2**30, 3),
            "cache_limit_gib": round(cache_limit() / 2**30, 3),
        }
    )
    facts["adapters"], facts["gpu"] = _gpu()
    return facts


def _extra(name: str, libraries: tuple[str, ...]) -> dict[str, Any]:
    versions: dict[str, str | None] = {}
    for library in libraries:
        try:
            versions[library] = importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            versions[library] = None
    missing = None in versions.values()
    return {"libraries": versions, "for": USES[name], "install": f"pip install 'orograph[{name}]'" if missing else None}


def _numcodecs() -> str | None:
    """What is wrong with the library that compresses stores; None: nothing."""
    try:
        from orograph import _blosc
    except ImportError as error:
        return f"numcodecs cannot be imported ({error}): stores can be neither written nor read"
    if _blosc.broken is None:
        return None
    return (
        f"numcodecs cannot be imported with all its codecs ({_blosc.broken}). Stores do not need the broken ones; "
        "other programs may: update or remove zfpy."
    )


def _gpu() -> tuple[list[dict[str, Any]], str]:
    """The adapters, and the result of a computation on the one that would be used."""
    from orograph.gpu.device import NoAdapterError, adapters, choose, open_device

    try:
        found = adapters()
    except NoAdapterError as error:
        return [], str(error)
    listed: list[dict[str, Any]] = [
        {"name": a.name, "kind": a.kind, "backend": a.backend, "driver": a.driver, "used": False} for a in found
    ]
    try:
        chosen = choose()
        listed[found.index(chosen)]["used"] = True
        begun = time.perf_counter()
        device = open_device()
        device.wait()
        took = (time.perf_counter() - begun) * 1e3
    except NoAdapterError as error:
        return listed, str(error)
    slow = " It is a software renderer: correct, but slow." if chosen.software else ""
    return listed, f"{chosen.name} answers in {took:.0f} ms.{slow}"


def _screen() -> str:
    if sys.platform in ("darwin", "win32"):
        return "the system's own"
    for name in ("WAYLAND_DISPLAY", "DISPLAY"):
        if os.environ.get(name):
            return f"{name}={os.environ[name]}"
    return "none: neither DISPLAY nor WAYLAND_DISPLAY is set, so no window can be opened (pictures can be drawn)"


def _memory() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (AttributeError, ValueError, OSError):
        return None
