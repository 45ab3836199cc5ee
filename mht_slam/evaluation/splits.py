"""Which half of a recording's runs tunes parameters, and which is scored."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

Item = TypeVar("Item")


def halves(items: Iterable[Item]) -> tuple[list[Item], list[Item]]:
    """Split by position: even places (0, 2, ...) tune parameters, odd places (1, 3, ...) score.

    The runs of a recording are in the order of its table, which is the order of time, so that both
    halves hold all its places and light. Whatever is chosen by looking at results - a gate, a
    prior, a model - is chosen on the first half only.

    >>> halves("abcde")
    (['a', 'c', 'e'], ['b', 'd'])
    """
    listed = list(items)
    return listed[::2], listed[1::2]
