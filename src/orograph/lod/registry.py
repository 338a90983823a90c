"""The methods by name, one line each. Everything that lists methods gets them from here.

A method's module is imported when the method is asked for. ``register`` adds methods from outside Orograph.

>>> from orograph.lod.registry import chosen
>>> choice = chosen("soar,error=wedgie,geomorph=yes")
>>> choice.options.error, str(choice)
('wedgie', 'soar,error=wedgie,geomorph=yes')
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from orograph.errors import UsageError
from orograph.lod.options import changed, parse, split

if TYPE_CHECKING:  # the command line lists names before anything is loaded
    from orograph.lod.method import Method, MethodInfo, Resources
    from orograph.lod.selection import Kind
    from orograph.store.terrain import Terrain

METHODS: dict[str, str | type[Method]] = {
    "raycast": "orograph.lod.raycast:RayCast",
    "triangle-patches": "orograph.lod.triangle_patches:TrianglePatches",
    "hybrid": "orograph.lod.hybrid:Hybrid",
    "top-down": "orograph.lod.top_down:TopDown",
    "roam": "orograph.lod.roam:Roam",
    "threshold-spheres": "orograph.lod.threshold_spheres:ThresholdSpheres",
    "stateless": "orograph.lod.stateless:Stateless",
    "soar": "orograph.lod.soar:Soar",
    "restricted-quadtree": "orograph.lod.restricted_quadtree:RestrictedQuadtree",
    "smart": "orograph.lod.smart:Smart",
    "seamless-patches": "orograph.lod.seamless_patches:SeamlessPatches",
    "cdlod": "orograph.lod.cdlod:Cdlod",
    "chunked-lod": "orograph.lod.chunked_lod:ChunkedLod",
    "bdam": "orograph.lod.bdam:Bdam",
    "quadtin": "orograph.lod.quadtin:QuadTin",
    "hyperblock": "orograph.lod.hyperblock:HyperBlock",
    "cbt": "orograph.lod.cbt:Cbt",
    "clipmap": "orograph.lod.clipmap:Clipmap",
}
"""Name to MODULE:CLASS, or to the class."""

Backend = Literal["cpu", "gpu"]

AUTO: dict[Backend, str] = {"cpu": "raycast", "gpu": "triangle-patches"}
"""What ``auto`` is, by what draws."""

M = TypeVar("M", bound="type[Method]")


@dataclass(frozen=True, slots=True)
class Choice:
    """A method with its options, as ``--method`` says it: ``NAME[,key=value…]``.

    Attributes:
        method: the class. options: of its ``info.options``.
    """

    method: type[Method]
    options: Any

    @property
    def info(self) -> MethodInfo:
        return self.method.info

    @property
    def conservative(self) -> bool:
        """Whether its bound is promised."""
        return self.info.conservative(self.options)

    @property
    def invents(self) -> bool:
        """Whether it draws detail beyond the data."""
        return self.info.invents(self.options)

    def __str__(self) -> str:
        return ",".join([self.info.name, *(f"{key}={text}" for key, text in changed(self.options).items())])

    def make(self, terrain: Terrain, resources: Resources | None = None) -> Method:
        """The method for a terrain; whatever it needs and the store lacks is made, and reported to the progress.

        Raises:
            UsageError: the terrain has no surface, or is too large; what has to be made does not fit into memory.
        """
        from orograph.lod.method import Resources
        from orograph.lod.needs import supply

        resources = Resources() if resources is None else resources
        supply(terrain, self.method.needs(self.options), resources)
        return self.method(terrain, self.options, resources)

    def check_promise(self, terrain: Terrain) -> None:
        """Raise UsageError if something about a terrain keeps the method from its promise."""
        obstacle = self.method.obstacle(self.options, terrain)
        if obstacle:
            raise UsageError(
                f"With {self} the tolerance, which `conservative` promises, cannot be promised for this terrain: "
                f"{obstacle}.",
                path=terrain.name,
                remedy="Choose another method, or read another part (`bbox`).",
            )

    def check_triangles(self) -> None:
        """Raise UsageError if the method makes no triangles."""
        if self.info.kind == "rays":
            raise UsageError(
                f"The method {self.info.name} casts rays: it makes no triangles.",
                remedy=f"Choose one of {', '.join(n for n in names() if method_of(n).info.kind != 'rays')}.",
            )


def method_of(name: str, backend: Backend = "cpu") -> type[Method]:
    """A method's class by its name; ``auto`` is what a backend draws by itself.

    Raises:
        UsageError: there is no method of that name.
    """
    found = METHODS.get(AUTO[backend] if name == "auto" else name)
    if found is None:
        raise UsageError(f"There is no method {name!r}; the methods are {', '.join(METHODS)}.")
    if not isinstance(found, str):
        return found
    module, _, kind = found.partition(":")
    method: type[Method] = getattr(importlib.import_module(module), kind)
    return method


def chosen(text: str, backend: Backend = "cpu") -> Choice:
    """The method that ``NAME[,key=value…]`` describes.

    Raises:
        UsageError: there is no such method, it has no such option, or the option cannot have that value.
    """
    name, given = split(text)
    method = method_of(name, backend)
    return Choice(method, parse(method.info.options, given, method.info.name))


def promised(text: str, backend: Backend = "cpu") -> Choice:
    """The method that ``NAME[,key=value…]`` describes, promising its tolerance.

    Options that decide whether it does are set accordingly, unless the text gives them.

    Raises:
        UsageError: as ``chosen``; or the method makes no such promise with these options.
    """
    name, given = split(text)
    info = method_of(name, backend).info
    choice = chosen(text, backend)
    if not choice.conservative:
        choice = Choice(choice.method, parse(info.options, {**info.promising, **given}, info.name))
    if not choice.conservative:
        raise UsageError(
            f"With {choice} the tolerance is not promised, which `conservative` requires.",
            remedy=f"See orograph methods {info.name}.",
        )
    return choice


def names(*kinds: Kind) -> tuple[str, ...]:
    """The names of all methods, or of those whose selections are of these kinds (which imports all)."""
    return tuple(name for name in METHODS if not kinds or method_of(name).info.kind in kinds)


def register(method: M) -> M:
    """Add a method under its ``info.name``; works as a decorator.

    Raises:
        UsageError: the name is taken, or is not a valid one.
    """
    name = method.info.name
    if name in METHODS or name == "auto" or not name or set(name) & set(",= "):
        raise UsageError(f"A method cannot be called {name!r}: that is not a valid name, or it is taken.")
    METHODS[name] = method
    return method
