"""HyperBlock-QuadTIN (Lario, Pajarola & Tirado 2003): which triangles blocks at given levels draw, by walking.

The hierarchy is that of ``reference/quadtin.py``, its triangles and vertices as numbers. A block is the two triangles
of an even depth with one vertex on their common base, and all below; it is called by that vertex. Level 0 splits
nothing, level k what is off by more than ε(k − 1). A vertex is split if its error exceeds the threshold of any block
that has a part of its diamond, or of a diamond that depends on it. There are no colours, ranks, neighbours or kept
strips here. The paper was at hand as an abstract only: the rule is derived (docs/methods/hyperblock.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass
class HyperBlock:
    """The blocks of a hierarchy.

    Attributes:
        children: the two halves of triangles that are split; 0 and 1 are the roots. node: the vertex that splits them.
        error: of vertices, saturated, metres. ends: ε of the levels from 1 on, metres, falling.
        depth: of the triangles that make blocks; even.
        blocks: of each vertex in blocks. parents: of each vertex, those that it depends on.
    """

    children: Mapping[int, tuple[int, int]]
    node: Mapping[int, int]
    error: Mapping[int, float]
    ends: Sequence[float]
    depth: int
    blocks: dict[int, set[int]] = field(default_factory=dict)
    parents: dict[int, set[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for root in (0, 1):
            self._walk(root, 0, None, None)
        changed = True
        while changed:
            changed = False
            for v, of in self.blocks.items():
                for p in self.parents[v] & self.blocks.keys():
                    if not of <= self.blocks[p]:
                        self.blocks[p] |= of
                        changed = True

    def _walk(self, t: int, depth: int, above: int | None, block: int | None) -> None:
        """Note what the vertex of a triangle depends on, and the block that its triangle lies in."""
        if t not in self.children:
            return
        v = self.node[t]
        if depth == self.depth:
            block = v
        if block is not None:
            self.blocks.setdefault(v, set()).add(block)
        self.parents.setdefault(v, set()).update(() if above is None else (above,))
        for child in self.children[t]:
            self._walk(child, depth + 1, v, block)

    def active(self, levels: Mapping[int, int]) -> set[int]:
        """The vertices in blocks that are split, by the levels of blocks."""
        most = {block: self.ends[k - 1] if k else float("inf") for block, k in levels.items()}
        return {v for v, of in self.blocks.items() if any(self.error[v] > most[block] for block in of)}

    def drawn(self, levels: Mapping[int, int]) -> set[int]:
        """The triangles that are drawn; all above blocks is split."""
        active, waiting, found = self.active(levels), [0, 1], set()
        while waiting:
            t = waiting.pop()
            if t in self.children and (self.node[t] in active or self.node[t] not in self.blocks):
                waiting += self.children[t]
            else:
                found.add(t)
        return found
