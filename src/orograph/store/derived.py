"""Data derived from a terrain's heights and stored beside them: each kind is declared once.

A kind declares its name in a store's record and in methods' needs, the version of its arrays, what it is made from,
where its arrays lie and how it is opened. Records, metadata, checks and readers go through the registry
(``registry.KINDS``) and name no kind. The tasks over shards that make a kind are in ``makers``; kinds that are put into
complete stores have a verb. Data of another version count as absent.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec

if TYPE_CHECKING:
    from orograph.store.layout import Record
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain

T = TypeVar("T")

Attributes = dict[str, Any]
Nodes = dict[str, dict[str, Any]]


class At(NamedTuple):
    """Where arrays lie: the grid of level 0, and samples along the sides of shards and chunks."""

    grid: Grid
    shard: int
    chunk: int


class Derived(ABC, Generic[T]):
    """A kind of derived data. Its entry in a record is a ``T``; ``nothing`` if the store has none.

    Attributes:
        name: in records and needs. version: of its arrays. group: the group of a store that holds them.
        needs: names of the kinds that it is made from, besides heights.
        later: whether it is put into complete stores, whose terrain stays the same.
        shared: whether several are added to its group one by one, so that the group's document must not list them.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    group: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    later: ClassVar[bool] = False
    shared: ClassVar[bool] = False

    @abstractmethod
    def nothing(self) -> T:
        """The entry of a record that has none."""

    @abstractmethod
    def parse(self, found: dict[str, Any], grid: Grid) -> T:
        """An entry from the JSON of a record."""

    @abstractmethod
    def to_json(self, what: T) -> dict[str, Any]:
        """The JSON of a record."""

    @abstractmethod
    def arrays(self, what: T, at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        """All its arrays, with their attributes."""

    def groups(self, what: T, at: At) -> tuple[Nodes, dict[str, bytes]]:
        """Its groups, and other objects (coordinates)."""
        from orograph.store.conventions import group

        paths = [spec.path for spec, _ in self.arrays(what, at)]
        inner = {path.rpartition("/")[0] for path in paths}
        return {path: group() for path in sorted({self.group, *inner})}, {}

    @abstractmethod
    def open(self, terrain: StoredTerrain, **options: Any) -> Any:
        """A reader of a store's data.

        Raises:
            StoreError: it has none made with these options.
        """

    def compute(self, terrain: MemoryTerrain, **options: Any) -> Any:
        """A reader of data computed now, for a terrain in memory.

        Raises:
            StoreError: only stores have such data.
        """
        raise StoreError(f"A terrain in memory has no {self.name}.", path=terrain.name)

    def has(self, terrain: StoredTerrain, **options: Any) -> bool:
        """Whether a store has it, made with these options."""
        try:
            self.open(terrain, **options)
        except StoreError:
            return False
        return True

    def remedy(self, url: str, keys: list[str]) -> str | None:
        """The call that rebuilds damaged objects; None: a repair rebuilds them from the heights."""
        return None

    def of(self, record: Record) -> T:
        """The entry of a record."""
        found = record.derived.get(self.name)
        return self.nothing() if found is None else found

    def put(self, record: Record, what: T) -> Record:
        """A record with this entry."""
        others = {name: other for name, other in record.derived.items() if name != self.name}
        return replace(record, derived={**others, self.name: what} if what else others)
