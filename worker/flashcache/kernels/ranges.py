"""The division of a compiled query's rows among threads."""

import math
from collections.abc import Callable

import torch

from flashcache.kernels import cpu


def over_rows(function: Callable[[int, int], None], num_rows: int, block: int) -> None:
    """Call `function(begin, end)` for all rows, in as many pieces as torch has threads.

    A piece is made of blocks of `block` rows, at least two: below that a thread costs more than it saves.
    The results do not depend on the number of threads, for each block is what it would be without others.
    """
    threads = torch.get_num_threads()
    pieces = min(threads, num_rows // (2 * block))
    if pieces <= 1:
        function(0, num_rows)
        return
    step = block * math.ceil(num_rows / (pieces * block))
    cpu.in_pool(lambda begin: function(begin, min(begin + step, num_rows)), range(0, num_rows, step), threads)
