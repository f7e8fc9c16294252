"""Keeping the basis in step with the generations of a state stream."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from .arrays import Arrays, Block, Combination, Dictionary, reconstruct
from .errors import ProblemError
from .frames import FloatArray, State

_MAX_DICTIONARY_BYTES = 1 << 30
_BYTES_PER_VERTEX = 3 * 4


class Tracker:
    """Turns states into displacements, fetching what a new generation changed when one arrives.

    It holds blocks of columns that generations share and makes of a new generation's combination what
    it can: after an edit inside a seam a few tens of kilobytes travel, once the blocks are held. They
    are many more columns than one basis, so they are fetched when ``prefetch`` is called, or else when
    whole bases have cost as much as they would have.
    """

    def __init__(self, source: Arrays, max_bytes: int = _MAX_DICTIONARY_BYTES) -> None:
        """Fetch the current basis; at most ``max_bytes`` of shared columns are held."""
        self._source = source
        self._max_bytes = max_bytes
        self._n_spent = 0
        """Columns fetched as whole bases since blocks were fetched last."""
        self._whole: FloatArray | None = None
        self._rest: tuple[int, FloatArray] | None = None
        self.dictionary = Dictionary()
        """The shared columns held."""
        self._combination = source.combination()
        self._take(self._combination, ())

    @property
    def generation(self) -> int:
        """The generation in use."""
        return self._combination.generation

    def basis(self) -> FloatArray:
        """The basis in use, (r, n_vertices, 3): multiplied out, if it is held as a combination."""
        if self._whole is not None:
            return self._whole
        return self.dictionary.basis(self._combination)

    def reconstruct(self, q: npt.ArrayLike) -> FloatArray:
        """The displacement of every vertex in m, (n_vertices, 3), at ``q`` of the generation in use."""
        if self._whole is not None:
            return reconstruct(self._whole, q)
        return self.dictionary.reconstruct(self._combination, q)

    def displacement(self, state: State) -> FloatArray:
        """The displacement of every vertex in m, (n_vertices, 3), at ``state``; rigid motion aside."""
        if state.generation != self.generation:
            self.follow(state.generation)
        return self.reconstruct(state.q)

    def positions(self, state: State) -> npt.NDArray[np.float64]:
        """Where every vertex is in m, (n_vertices, 3), at ``state``: x = t + R (X + u), rigid motion included.

        Rest positions are fetched once for each generation that is asked for: a closing moves them.
        """
        moved = self.displacement(state).astype(np.float64)
        if self._rest is None or self._rest[0] != state.generation:
            self._rest = state.generation, self._source.positions(state.generation, dtype="f64")
        moved += self._rest[1]
        return moved @ state.rotation.T + state.rigid[:3]

    def follow(self, generation: int) -> None:
        """Go over to ``generation``; blocks that no further edit of it would use are dropped."""
        combination = self._source.combination(generation)
        self._take(combination, () if self._whole is not None else self._combination.blocks)
        self._drop_useless(combination.prepared)

    def prefetch(self) -> bool:
        """Fetch the blocks prepared for further edits, as far as the limit allows.

        Returns whether all are held now: edits inside the seams then cost their W alone. To be called
        while nothing else is urgent, and again when more seams have been prepared.
        """
        combination = self._source.combination()
        self._drop_useless(combination.prepared)
        for block in self.dictionary.missing(combination.prepared):
            n_bytes = block.n_columns * combination.n_vertices * _BYTES_PER_VERTEX
            if self.dictionary.n_bytes + n_bytes <= self._max_bytes:
                columns = self._source.block(block, combination.generation)
                self.dictionary.blocks[block.id] = columns
        return not self.dictionary.missing(combination.prepared)

    def _take(self, combination: Combination, old: Iterable[Block]) -> None:
        """Make displacements of ``combination``.

        Of shared columns, if those that are missing are no more than the basis has together with what
        was spent on whole bases that they would have saved (then never twice what would have been best
        is fetched); otherwise of the whole basis. ``old`` blocks stay until all is well.
        """
        missing = self.dictionary.missing(combination.blocks)
        n_missing = sum(block.n_columns for block in missing)
        bytes_per_column = combination.n_vertices * _BYTES_PER_VERTEX
        fits = combination.n_columns * bytes_per_column <= self._max_bytes
        if fits and n_missing <= combination.size + self._n_spent:
            keep = {block.id for block in (*old, *combination.blocks)}
            self._make_room(keep, n_missing * bytes_per_column)
            try:
                for block in missing:
                    columns = self._source.block(block, combination.generation)
                    self.dictionary.blocks[block.id] = columns
                self._n_spent = max(0, self._n_spent - max(0, n_missing - combination.size))
                self._combination, self._whole = combination, None
                return
            except ProblemError as error:
                # The generation has been dropped meanwhile, or a block is larger than may be sent.
                if error.status not in (404, 413):
                    raise
        whole = self._source.basis(combination.generation)
        self._n_spent += combination.size
        self._combination, self._whole = combination, whole

    def _drop_useless(self, prepared: Iterable[Block]) -> None:
        """Keep the blocks in use and the prepared ones; of these only as many as the limit allows."""
        used = set() if self._whole is not None else {b.id for b in self._combination.blocks}
        keep = used | {block.id for block in prepared}
        for dropped in [id_ for id_ in self.dictionary.blocks if id_ not in keep]:
            del self.dictionary.blocks[dropped]
        self._make_room(used, 0)

    def _make_room(self, keep: set[int], n_bytes: int) -> None:
        """Drop blocks that are not in ``keep``, as many as it takes to fit ``n_bytes`` more.

        The youngest first: those of the base body's modes, which every edit uses, are the oldest.
        """
        for dropped in sorted((i for i in self.dictionary.blocks if i not in keep), reverse=True):
            if self.dictionary.n_bytes + n_bytes <= self._max_bytes:
                return
            del self.dictionary.blocks[dropped]
